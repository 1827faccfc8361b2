"""`python -m benchmarks`: its arguments, its errors and its files."""

import functools
import json

import pytest
import typer

from benchmarks import rows, suite
from benchmarks.__main__ import app
from benchmarks.rows import Row
from evo_cpg.cli.main import main

QUICK = ("brain", "--quick", "--sizes", "3,17")


@pytest.fixture
def cli(command_line_of):
    return command_line_of(functools.partial(main, app))


@pytest.fixture(autouse=True)
def two_devices(monkeypatch):
    # JAX already has its two devices, and other tests need its compiled programs.
    monkeypatch.setattr(suite, "use_cores", lambda: 2)


def test_help_names_every_case():
    command = typer.main.get_command(app)
    (cases,) = (each for each in command.params if each.name == "cases")
    text = str(vars(cases)["help"])
    words = text.removesuffix(" (default: all).").replace(" or ", ", ").split(", ")
    assert words == list(suite.CASES)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["swimer"], ["there is no case 'swimer'", "did you mean 'swimmer'?", "startup"]),
        (["brain", "--sizes", "1,x"], ["--sizes: 'x' is not a number", "1,15,200"]),
        (["brain", "--sizes", "0"], ["'0' is not a number", "from 1 to 1000000"]),
        (["brain", "--sizes", "-5"], ["'-5' is not a number"]),
        (["ga", "--sizes", "15"], ["--sizes: ga has a fixed number of individuals"]),
        (["brain", "--compare", "nowhere.json"], ["--compare: nowhere.json cannot be read"]),
        (["brain", "--plot", "bench.txt"], ["bench.txt", "'.txt'", ".png"]),
        (["brain", "--json", "/proc/bench.json"], ["--json: /proc/bench.json cannot be written"]),
    ],
)
def test_an_error_is_one_line(cli, monkeypatch, tmp_path, arguments, words):
    monkeypatch.chdir(tmp_path)
    complaint = cli.refuses(*arguments)
    assert complaint.count("\n") == 1
    assert all(word in complaint for word in words), complaint


def test_measured_rows_are_kept_if_the_next_case_fails(cli, monkeypatch, tmp_path):
    """Each row is printed to standard error and written to the file at once."""
    kept, seen = tmp_path / "bench.json", []

    def measure(plan, peak):
        yield Row("cpg", "oscillators", 1, 5e6, "steps/s", "a test")
        seen.append([row["size"] for row in json.loads(kept.read_text())["rows"]])
        yield Row("cpg", "oscillators", 2, 8e6, "steps/s", "a test", peer="MuJoCo", ratio=2.0)
        seen.append([row["size"] for row in json.loads(kept.read_text())["rows"]])
        raise KeyboardInterrupt

    monkeypatch.setitem(suite.CASES, "cpg", suite.Case(measure))
    code, out, err = cli("cpg", "--quick", "--json", kept)
    assert (code, out) == (130, "")
    assert seen == [[1], [1, 2]]
    assert [row.size for row in rows.load(kept)[1]] == [1, 2]
    assert "cpg, oscillators, 1: 5 M steps/s\n" in err
    assert "cpg, oscillators, 2: 8 M steps/s, 2x MuJoCo\n" in err
    assert [path.name for path in tmp_path.iterdir()] == ["bench.json"]


@pytest.mark.slow
def test_rates_are_written_and_compared(cli, tmp_path):
    """A hundredth of the earlier rate is slower, and a hundredfold rate is not."""
    kept, drawn = tmp_path / "new" / "bench.json", tmp_path / "bench.png"
    out, _ = cli.passes(*QUICK, "--json", kept, "--plot", drawn)
    assert "brain, network" in " ".join(out.split())
    assert drawn.is_file()
    record = json.loads(kept.read_text())
    assert [row["size"] for row in record["rows"]] == [3, 17]
    assert record["machine"]["cores"] == 2 and record["machine"]["float32_peak"] > 0
    for factor, expected in ((0.01, 0), (100, 3)):
        earlier = tmp_path / "earlier.json"
        scaled = [{**row, "rate": row["rate"] * factor} for row in record["rows"]]
        earlier.write_text(json.dumps({**record, "rows": scaled}))
        code, out, _ = cli(*QUICK, "--compare", earlier)
        assert code == expected
        assert ("SLOWER" in out) == bool(expected)
