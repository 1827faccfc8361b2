"""Models whose gravity is tilted: the import turns the world until gravity points down."""

import mujoco
import numpy as np
import pytest

from benchmarks.imported_models import largest_difference
from evo_cpg.io.models.compiled import compile_model
from evo_cpg.io.models.mjcf_import import read_model
from evo_cpg.io.models.refusals import ExchangeError

# A free animal of two bodies that sinks into a floor and into a post on a fixed body. Contacts have
# no friction, because the pyramids of MuJoCo's friction depend on the axes of the world.
MODEL = """
<mujoco>
  <option gravity="{}" wind="1 2 3" density="200" viscosity="0.3"/>
  <default><geom condim="1"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1" pos="0 0 0.1" euler="5 0 0"/>
    <body name="post" pos="0.1 0 0.1"><geom size="0.1"/></body>
    <body name="torso" pos="0 0 0.19" euler="10 20 30">
      <freejoint/><geom type="box" size="0.2 0.1 0.1"/>
      <body name="limb" pos="0.2 0 0">
        <joint axis="0 1 0" stiffness="2" springref="20"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
TILTED = ["1 0 -9", "0 -9.81 0", "0 0 9.81", "0.00001 0 -9.81", "-3 4 5"]


@pytest.fixture
def write(tmp_path):
    """Write the model with a gravity."""

    def call(gravity: str):
        path = tmp_path / "model.xml"
        path.write_text(MODEL.format(gravity), encoding="utf-8")
        return path

    return call


@pytest.mark.parametrize("gravity", TILTED)
def test_a_turned_world_moves_as_the_original(write, gravity):
    """Contacts, the wind and weight give the same joint acceleration, and a turned one of the root.

    Both accelerations are MuJoCo's: of the file, and of the turned model.
    """
    compiled = compile_model(write(gravity))
    original = mujoco.MjModel.from_xml_path(str(write(gravity)))
    found = []
    for model in (original, compiled.model):
        data = mujoco.MjData(model)
        data.qvel[3:] = 1.0, 2.0, 3.0, 4.0
        mujoco.mj_forward(model, data)
        assert data.ncon >= 2
        found.append((data.qacc, data.xmat[2].reshape(3, 3)))
    (theirs, attitude), (ours, turned) = found
    np.testing.assert_allclose(ours[3:], theirs[3:], rtol=1e-6)
    np.testing.assert_allclose(turned.T @ ours[:3], attitude.T @ theirs[:3], rtol=1e-6)
    np.testing.assert_array_equal(compiled.model.opt.gravity[:2], 0.0)


@pytest.mark.parametrize("gravity", TILTED[:2])
def test_a_model_with_tilted_gravity_accelerates_as_in_mujoco(write, gravity):
    assert largest_difference(write(gravity), states=5) < 1e-10


def test_a_level_floor_becomes_a_slope(write):
    """Gravity of 10 degrees towards x acts like a floor that falls by 10 degrees towards x."""
    angle = np.deg2rad(10.0)
    path = write(f"{9.81 * np.sin(angle)} 0 {-9.81 * np.cos(angle)}")
    path.write_text(path.read_text(encoding="utf-8").replace('euler="5 0 0"', ""), encoding="utf-8")
    imported = read_model(path)
    world = imported.experiment["world"]
    assert world["gravity"] == pytest.approx(9.81)
    floor = world["ground"]["floor"]
    assert floor["slope_deg"] == pytest.approx(10.0)
    assert floor.get("downhill_deg", 0.0) == pytest.approx(0.0)
    assert imported.warnings[0] == (
        "the world is turned by 10 degrees, so that gravity points down"
    )


def test_switched_off_gravity_turns_nothing(write):
    path = write("1 2 3")
    text = path.read_text(encoding="utf-8").replace(
        "<worldbody>", '<option><flag gravity="disable"/></option><worldbody>', 1
    )
    path.write_text(text, encoding="utf-8")
    imported = read_model(path)
    assert imported.experiment["world"]["gravity"] == 0.0
    assert not any("turned" in sentence for sentence in imported.warnings)


def test_a_gravity_without_numbers_is_refused(write, tmp_path, monkeypatch):
    # MuJoCo writes warnings to a file in the working folder, and older versions stop.
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ExchangeError, match=r"gravity holds no numbers|MuJoCo cannot load it"):
        read_model(write("nan 0 0"))
