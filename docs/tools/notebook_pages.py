"""Show Jupyter notebooks as pages with the output of their cells, and run them again.

    python docs/tools/notebook_pages.py docs/notebooks/*.ipynb

runs the cells of each notebook in order, and writes their output into it: text and figures of
matplotlib. Cells are plain Python, without magic commands.
"""

import base64
import contextlib
import io
import json
import sys
from pathlib import Path
from typing import Any

from myst_parser.parsers.sphinx_ import MystParser

Notebook = dict[str, Any]


def as_markdown(notebook: Notebook) -> str:
    """Return the cells in order, each with its output below it."""
    pieces = []
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            pieces.append(source)
            continue
        pieces.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            if output["output_type"] == "stream":
                pieces.append(f"```text\n{''.join(output['text']).rstrip()}\n```")
            else:
                pieces.append(f"![](data:image/png;base64,{output['data']['image/png'].strip()})")
    return "\n\n".join(pieces) + "\n"


def run(notebook: Notebook) -> Notebook:
    """Return the notebook with new output of its cells."""
    import matplotlib.pyplot as plt

    plt.close("all")  # figures that other code left open do not belong to the notebook
    names: dict[str, Any] = {"__name__": "__main__"}
    cells, count = [], 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            count += 1
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(compile("".join(cell["source"]), f"cell {count}", "exec"), names)
            outputs: list[dict[str, Any]] = []
            if printed.getvalue():
                text = printed.getvalue().splitlines(keepends=True)
                outputs.append({"name": "stdout", "output_type": "stream", "text": text})
            outputs += [_picture(plt.figure(number)) for number in plt.get_fignums()]
            plt.close("all")
            cell = cell | {"execution_count": count, "outputs": outputs}
        cells.append(cell)
    return notebook | {"cells": cells}


def _picture(figure: Any) -> dict[str, Any]:
    png = io.BytesIO()
    figure.savefig(png, format="png", dpi=80, bbox_inches="tight")
    data = {"image/png": base64.b64encode(png.getvalue()).decode()}
    return {"data": data, "metadata": {}, "output_type": "display_data"}


class NotebookParser(MystParser):
    """Parser that reads notebooks as pages of MyST Markdown."""

    supported = ("ipynb",)

    def parse(self, inputstring: str, document: Any) -> None:
        """Parse the cells and their outputs."""
        super().parse(as_markdown(json.loads(inputstring)), document)


def setup(app: Any) -> dict[str, bool]:
    """Register the parser with Sphinx."""
    app.add_source_suffix(".ipynb", "ipynb")
    app.add_source_parser(NotebookParser)
    return {"parallel_read_safe": True}


if __name__ == "__main__":
    import matplotlib

    matplotlib.use("Agg")
    for name in sys.argv[1:]:
        path = Path(name)
        made = run(json.loads(path.read_text(encoding="utf-8")))
        text = json.dumps(made, indent=1, ensure_ascii=False) + "\n"
        path.write_text(text, encoding="utf-8")
