"""`evo-cpg configs`, names of shipped configurations, and completions for a shell."""

import json
import subprocess
import sys

import pytest

from evo_cpg.cli.options import complete_config
from evo_cpg.io import shipped as module
from evo_cpg.io.file_schema import file_schema
from evo_cpg.io.shipped import shipped, shipped_names
from tiny_run import PAIR, REPOSITORY

NAME = "iwadate2010_swimmer"


def test_the_list_has_every_name_with_its_study(cli, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    code, out, err = cli("configs")
    assert (code, err) == (0, "")
    for name in shipped_names():
        line = next(line for line in out.splitlines() if f" {name} " in line)
        assert shipped(name).summary in line
        assert (shipped(name).study or "ours") in line


def test_missing_configurations_are_an_error(cli, monkeypatch):
    monkeypatch.setattr(module, "shipped_folder", lambda: None)
    assert "no configurations" in cli.refuses("configs")


def test_the_schema_is_printed_as_json(cli):
    code, out, err = cli("configs", "schema")
    assert (code, err) == (0, "") and json.loads(out) == file_schema()


def test_a_copy_goes_to_the_working_folder_or_another(cli, tmp_path):
    code, out, err = cli("configs", "copy", "hexapod", folder=tmp_path)
    assert (code, out, err) == (0, "hexapod.yaml\n", "")
    assert (tmp_path / "creatures" / "hexapod.yaml").is_file()
    code, out, _ = cli("configs", "copy", "hexapod", "mine", folder=tmp_path)
    assert (code, out) == (0, "mine/hexapod.yaml\n")
    code, out, _ = cli("validate", "mine/hexapod.yaml", folder=tmp_path)
    assert code == 0 and out.startswith("mine/hexapod.yaml: 13 bodies")


def test_a_failed_copy_is_one_line(cli, tmp_path):
    (tmp_path / "file").touch()
    err = cli.refuses("configs", "copy", "hexapod", "file", folder=tmp_path)
    assert err == "evo-cpg: cannot write file (File exists)\n"
    (tmp_path / "hexapod.yaml").write_text("mine")
    assert "already exists" in cli.refuses("configs", "copy", "hexapod", folder=tmp_path)


@pytest.mark.parametrize("given", [NAME, f"{NAME}.yaml"])
def test_only_a_run_of_a_shipped_configuration_records_its_name(cli, tmp_path, given):
    cli("configs", "copy", NAME, folder=tmp_path)
    settings = (*PAIR, "evolution.generations=1")
    code, out, err = cli("train", given, *settings, folder=tmp_path)
    assert (code, out) == (0, f"runs/{NAME}\n"), err
    meta = json.loads((tmp_path / out.strip() / "meta.json").read_text())
    assert meta.get("shipped_config") == (NAME if given == NAME else None)


@pytest.mark.parametrize("command", ["train", "preview", "validate", "cpg", "sweep", "export"])
def test_every_command_suggests_the_nearest_name(cli, tmp_path, command):
    more = {"sweep": ["--grid", "seed=1,2"], "export": ["x.xml"]}
    err = cli.refuses(command, "hexapodd", *more.get(command, []), folder=tmp_path)
    assert err.startswith("evo-cpg: hexapodd: no such file here") and err.count("\n") == 1
    assert "did you mean 'hexapod' or 'hexapod_tripod'?" in err


def test_completions_are_names_files_and_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("runs/one", "runs/two", "hex"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "runs" / "one" / "config.yaml").touch()
    (tmp_path / "hexa.yaml").touch()
    (tmp_path / "hex.txt").touch()
    assert complete_config("hex") == ["hexapod", "hexapod_tripod", "hex/", "hexa.yaml"]
    assert complete_config("") == [*shipped_names(), "hex/", "hexa.yaml", "runs/"]
    assert complete_config("runs/o") == ["runs/one/"]
    assert complete_config("nowhere/") == []


def test_bash_completion_does_not_import_jax(tmp_path):
    """The shell passes the typed words in the environment, and reads completions from stdout."""
    words = {"COMP_WORDS": f"evo-cpg train {NAME[:8]}", "COMP_CWORD": "2"}
    completed = subprocess.run(
        [
            sys.executable,
            "-c",
            "import atexit, sys\n"
            "atexit.register(lambda: print('jax' in sys.modules, file=sys.stderr))\n"
            "sys.argv = ['evo-cpg']\n"
            "from evo_cpg.cli.main import main\n"
            "main()",
        ],
        env={"_EVO_CPG_COMPLETE": "complete_bash", "PYTHONPATH": str(REPOSITORY), **words},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    names = [name for name in shipped_names() if name.startswith("iwadate")]
    assert completed.stdout.split() == names
    assert completed.stderr == "False\n"
