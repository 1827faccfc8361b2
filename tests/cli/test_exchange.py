"""`evo-cpg export` and `evo-cpg import`: files that load, and nothing overwritten."""

import shutil

import mujoco
import pytest
import yaml

from evo_cpg.config.load import load_config
from tiny_run import CONFIG, REPOSITORY

WALKER = REPOSITORY / "configs" / "hexapod.yaml"


def test_a_config_goes_out_and_its_animal_comes_back(cli, tmp_path):
    model, animal = tmp_path / "hexapod.xml", tmp_path / "animal.yaml"
    code, out, err = cli("export", WALKER, model)
    assert (code, out, err) == (0, f"{model}\n", "")
    compiled = mujoco.MjModel.from_xml_path(str(model))
    assert (compiled.nbody, compiled.nu) == (14, 12)
    assert compiled.opt.timestep == pytest.approx(1 / 240)
    code, out, err = cli("import", model, animal)
    assert (code, out) == (0, f"{animal}\n")
    assert err == "left out: gravity (0, 0, -9.81) m/s^2, geom 'ground'\n"
    config = yaml.safe_load(WALKER.read_text())
    (tmp_path / "again.yaml").write_text(yaml.safe_dump(config | {"creature": "animal.yaml"}))
    found, given = load_config(tmp_path / "again.yaml"), load_config(WALKER)
    assert found.creature.build().mass == pytest.approx(given.creature.build().mass, rel=1e-12)
    code, out, _ = cli("validate", tmp_path / "again.yaml")
    assert code == 0 and "13 bodies, 12 joint axes" in out


def test_a_run_goes_out_and_says_what_stays(cli, tmp_path):
    run, model = tmp_path / "run", tmp_path / "swimmer.xml"
    run.mkdir()
    config = yaml.safe_load(CONFIG.read_text())
    config["creature"] = str(REPOSITORY / "configs" / config["creature"])
    (run / "config.yaml").write_text(yaml.safe_dump(config))
    code, out, err = cli("export", run, model)
    assert (code, out, err) == (0, f"{model}\n", "left out: the water, all of it but buoyancy\n")
    assert mujoco.MjModel.from_xml_path(str(model)).body_gravcomp[1:].tolist() == [1.0] * 10
    shutil.rmtree(run)
    run.mkdir()
    code, out, err = cli("export", run, tmp_path / "other.xml")
    assert (code, out) == (2, "")
    assert err == f"evo-cpg: {run} is not a run folder (it has no config.yaml)\n"


@pytest.mark.parametrize("command", ["export", "import"])
def test_a_file_is_replaced_only_when_told(cli, tmp_path, command):
    model, used = tmp_path / "in.xml", tmp_path / "out"
    assert cli("export", WALKER, model)[0] == 0
    source = WALKER if command == "export" else model
    used.write_text("years of work")
    assert cli(command, source, used) == (
        2,
        "",
        f"evo-cpg: {used} exists already; --overwrite replaces it\n",
    )
    assert used.read_text() == "years of work"
    assert cli(command, source, used, "--overwrite")[0] == 0
    assert "hexapod" in used.read_text()
    code, out, err = cli(command, source, tmp_path / "no" / "out")
    assert (code, out) == (2, "")
    assert (
        err == f"evo-cpg: {tmp_path / 'no' / 'out'} cannot be written (No such file or directory)\n"
    )


def test_what_cannot_come_in_is_refused_and_nothing_written(cli, tmp_path):
    model, animal = tmp_path / "model.xml", tmp_path / "animal.yaml"
    model.write_text(
        '<mujoco><worldbody><body name="b"><geom size="1"/></body></worldbody></mujoco>'
    )
    code, out, err = cli("import", model, animal)
    assert (code, out) == (2, "")
    assert err == (
        f"evo-cpg: {model}: body 'b': the root does not float freely; allowed: a freejoint\n"
    )
    code, out, err = cli("import", model, animal, "--motor-gain", 0)
    assert (code, err) == (2, "evo-cpg: --motor-gain: must be greater than 0, got 0\n")
    assert not animal.exists()
