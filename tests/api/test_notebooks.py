"""The notebooks of the docs run, and their pages show their output."""

import json
import sys

import jax
import pytest

import evo_cpg as evo
from tiny_run import REPOSITORY

pytest.importorskip("myst_parser", reason="docs/tools needs what the documentation is built with")
sys.path.insert(0, str(REPOSITORY / "docs" / "tools"))
import notebook_pages

NOTEBOOKS = sorted((REPOSITORY / "docs/notebooks").glob("*.ipynb"))


def read(path):
    return json.loads(path.read_text(encoding="utf-8"))


def printed(notebook) -> str:
    return "".join(
        "".join(output["text"])
        for cell in notebook["cells"]
        for output in cell.get("outputs", ())
        if output["output_type"] == "stream"
    )


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_pages_show_notebooks_that_ran_in_order(path):
    notebook = read(path)
    page = notebook_pages.as_markdown(notebook)
    assert page.startswith("# Notebook: ") and "data:image/png;base64," in page
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    for cell in code:
        compile("".join(cell["source"]), path.name, "exec")
    # Every reader of the docs downloads the notebooks.
    assert path.stat().st_size < 250_000


def test_cells_run_in_order_and_keep_their_output(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    sources = ["# Notebook: x", "a = 2", "import matplotlib.pyplot as plt\nplt.plot([a])\nprint(a)"]
    kinds = ["markdown", "code", "code"]
    cells = [
        {"cell_type": kind, "source": [source]} | ({"outputs": []} if kind == "code" else {})
        for kind, source in zip(kinds, sources, strict=True)
    ]
    made = notebook_pages.run({"cells": cells})
    assert printed(made) == "2\n"
    page = notebook_pages.as_markdown(made)
    assert "```text\n2\n```" in page and page.count("data:image/png;base64,iVBOR") == 1
    with pytest.raises(ZeroDivisionError):
        notebook_pages.run({"cells": [{"cell_type": "code", "source": ["1 / 0"], "outputs": []}]})


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run_to_the_same_conclusions(path, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    jax.devices()
    made, before = notebook_pages.run(read(path)), printed(read(path))
    # Numbers differ between machines, but conclusions do not.
    assert [line.split()[-1] for line in printed(made).splitlines()[:1]] == [
        line.split()[-1] for line in before.splitlines()[:1]
    ]
    if path.stem == "evolve":
        left = next(line for line in printed(made).splitlines() if "is left" in line)
        assert int(left.split("%")[0].split()[-1]) < 60
    else:
        start, end = next(
            line for line in printed(made).splitlines() if line.startswith("from")
        ).split()[1::2]
        assert float(end) > float(start)


def test_the_api_reference_has_every_public_name():
    import re

    page = (REPOSITORY / "docs/reference/api.md").read_text()
    assert sorted(re.findall(r"^### `(\w+)`", page, re.M)) == sorted(evo.__all__)
