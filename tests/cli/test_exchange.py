"""`evo-cpg export` and `evo-cpg import`: their files load, and they overwrite no file."""

import shutil

import equinox as eqx
import mujoco
import numpy as np
import pytest
import trimesh
import yaml
from scipy.spatial.transform import Rotation

from evo_cpg.api import runs
from evo_cpg.io.load import load_config
from evo_cpg.simulation.situation import Situation
from evo_cpg.training.run_folder import RunFolder
from tiny_run import REPOSITORY, own_config

WALKER = REPOSITORY / "configs" / "hexapod.yaml"


def test_an_exported_animal_is_imported_unchanged(cli, tmp_path):
    model, animal = tmp_path / "hexapod.xml", tmp_path / "animal.yaml"
    code, out, err = cli("export", WALKER, model)
    assert (code, out, err) == (0, f"{model}\n", "")
    compiled = mujoco.MjModel.from_xml_path(str(model))
    assert (compiled.nbody, compiled.nu) == (14, 12)
    assert compiled.opt.timestep == pytest.approx(1 / 240)
    code, out, err = cli("import", model, animal)
    assert (code, out, err) == (0, f"{animal}\n", "")
    found, given = load_config(animal), load_config(WALKER)
    assert found.creature.build().mass == pytest.approx(given.creature.build().mass, rel=1e-12)
    code, out, _ = cli("validate", animal)
    assert code == 0 and "13 bodies, 12 joint axes" in out
    assert cli("import", model, animal, "--creature", "--overwrite")[0] == 0
    config = yaml.safe_load(WALKER.read_text())
    (tmp_path / "again.yaml").write_text(yaml.safe_dump(config | {"creature": "animal.yaml"}))
    assert load_config(tmp_path / "again.yaml").task == given.task


# A ball beside a cart on a rail, with a light and a height field.
CART = """<mujoco model="cart"><worldbody><light/>
<body name="cart"><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1"/></body>
<body name="ball"><freejoint/><geom size="1"/></body></worldbody>
<actuator><motor joint="x" gear="2"/></actuator></mujoco>"""


def test_an_import_lists_what_is_lost(cli, tmp_path, monkeypatch):
    """The name of the file follows the model's."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cart.xml").write_text(CART)
    err = cli.refuses("import", "cart.xml")
    assert "body 'ball': it moves beside body 'cart'" in err and "--drop" in err
    code, out, err = cli("import", "cart.xml", "--drop")
    assert (code, out) == (0, "cart.yaml\n")
    lines = err.splitlines()
    assert lines[0] == "left out, without harm: 1 light"
    assert lines[1].startswith("dropped: body 'ball': it moves beside body 'cart'")
    head = (tmp_path / "cart.yaml").read_text().splitlines()
    assert head[:3] == ["# Imported from cart.xml.", "# Left out, without harm:", "#   1 light"]
    assert head[4].startswith("#   body 'ball': it moves beside")
    code, out, _ = cli("validate", "cart.yaml")
    assert code == 0 and out.startswith("cart.yaml: 1 bodies, 1 joint axes")


@pytest.mark.slow
def test_an_imported_model_trains_at_once(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cart.xml").write_text(CART)
    assert cli("import", "cart.xml", "--drop")[0] == 0
    small = (
        "evolution.generations=2 evolution.population=4 evolution.elites=1 simulation.seconds=.03"
    )
    cli.passes("train", "cart.yaml", *small.split())


def test_a_settled_start_is_exported_as_a_keyframe(cli, tmp_path, monkeypatch):
    """The root leans and the joints are bent. All bodies have the same positions in MuJoCo."""
    built, lean = runs.build, Rotation.from_euler("xyz", (0.1, -0.2, 0.7))
    orientation = tuple(lean.as_quat(scalar_first=True).tolist())
    angles = tuple(np.linspace(-0.3, 0.3, 12).tolist())
    rest = Situation((1.0, 2.0, 0.2), 0.7, None, orientation, angles)

    def settled(*given):
        experiment = built(*given)
        simulation = eqx.tree_at(lambda s: s.situations, experiment.simulation, (rest,))
        return experiment._replace(simulation=simulation)

    monkeypatch.setattr(runs, "build", settled)
    assert cli("export", WALKER, tmp_path / "hexapod.xml")[0] == 0
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "hexapod.xml"))
    pose = model.key("start").qpos
    np.testing.assert_allclose(pose[:7], [*rest.start_position, *orientation])
    np.testing.assert_allclose(sorted(pose[7:]), angles)


def test_export_of_a_run_names_the_parts_left_out(cli, tmp_path):
    run, model = tmp_path / "run", tmp_path / "swimmer.xml"
    run.mkdir()
    (run / "config.yaml").write_text(yaml.safe_dump(own_config()))
    code, out, err = cli("export", run, model)
    assert (code, out, err) == (0, f"{model}\n", "left out: the water, except buoyancy\n")
    assert mujoco.MjModel.from_xml_path(str(model)).body_gravcomp[1:].tolist() == [1.0] * 10
    shutil.rmtree(run)
    run.mkdir()
    assert "is not a run folder" in cli.refuses("export", run, tmp_path / "other.xml")


@pytest.mark.parametrize("command", ["export", "import"])
def test_wrong_places_are_refused(cli, tmp_path, command):
    """A file is replaced only with `--overwrite`, and no file can have the long name."""
    name = "out.xml" if command == "export" else "out.yaml"
    model, used, long = tmp_path / "in.xml", tmp_path / name, 300 * "a"
    assert cli("export", WALKER, model)[0] == 0
    source = WALKER if command == "export" else model
    used.write_text("years of work")
    for given, place, words in (
        (source, used, "--overwrite"),
        (source, tmp_path / "no" / name, "there is no folder"),
        (source, tmp_path / f"{long}{used.suffix}", "(File name too long)"),
        (f"{long}{source.suffix}", tmp_path / f"new{used.suffix}", "(File name too long)"),
    ):
        err = cli.refuses(command, given, place)
        assert words in err and err.count("\n") == 1
    assert used.read_text() == "years of work"
    assert cli(command, source, used, "--overwrite")[0] == 0
    assert "hexapod" in used.read_text()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), "no body of the file moves"),
        (("--motor-gain", 0), "must be greater than 0"),
        (("--motor-gain", "1e13"), "must be at most 1e+12"),
        (("--motor-gain", "inf"), "must be at most 1e+12"),
    ],
)
def test_a_refused_import_writes_nothing(cli, tmp_path, options, words):
    model, animal = tmp_path / "model.xml", tmp_path / "animal.yaml"
    body = '<body name="b"><geom size="1"/></body>'
    model.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    assert words in cli.refuses("import", model, animal, *options)
    assert not animal.exists()


@pytest.fixture(scope="module")
def exported(cli, finished_run, tmp_path_factory):
    """Export the motion of a run to a file of each suffix."""
    place = tmp_path_factory.mktemp("exported")
    for name in ("motion.csv", "motion.npz", "motion.glb"):
        code, out, err = cli("export", finished_run, place / name)
        assert (code, out) == (0, f"{place / name}\n"), err
    return place


@pytest.mark.slow
def test_an_exported_motion_and_scene_are_those_of_the_film(finished_run, exported):
    _, motion, _ = RunFolder(finished_run).load_champion()
    with np.load(exported / "motion.npz", allow_pickle=False) as arrays:
        np.testing.assert_allclose(arrays["head.y"], motion.position[:, 0, 1], atol=1e-6)
    scene = trimesh.load_scene(exported / "motion.glb")
    assert {"head", "segment1"} <= set(scene.geometry)


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("a.obj", (), "the name ends in '.obj'"),
        ("a", (), "the name has no suffix"),
        ("a.glb", (), "is not a run folder"),
        ("a.xml", ("--trial", 1), "has no motion"),
    ],
)
def test_impossible_exports_are_refused(cli, tmp_path, name, options, words):
    assert words in cli.refuses("export", WALKER, tmp_path / name, *options)
    assert not (tmp_path / name).exists()
