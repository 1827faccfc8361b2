"""What the page draws: joints of all kinds, further shapes, bodies without a shape, and eyes."""

from pathlib import Path

import numpy as np

from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.io.yaml_text import parse_yaml
from evo_cpg.view.drawing_page.blocks import mirror, separate
from evo_cpg.view.drawing_page.lookup import posed
from evo_cpg.view.drawing_page.parts import add_part
from evo_cpg.view.drawing_page.scene import scene

HERE = Path("animal.yaml")
TEXT = """\
name: rail
creature:
  name: rail
  materials: {flesh: {density: 1000}}
  bodies:
    - name: cart
      shape: {type: box, size: [0.2, 0.1, 0.1]}
      material: flesh
      parts:
        - {shape: {type: sphere, radius: 0.05}, at: [0, 0, 0.1], rotation_deg: [0, 0, 90]}
      joint: {parent: world, at: [0, 0, 0], child_at: [0, 0, 0], axes: [{slide: x}]}
    - name: hub
      shape: null
      mass: 0
      material: flesh
      joint: {parent: cart, at: [0, 0.05, 0], child_at: [0, 0, 0], axes: [], limits_deg: null}
    - name: arm
      shape: {type: cylinder, radius: 0.01, length: 0.1}
      material: flesh
      joint:
        parent: hub
        at: [0, 0, 0]
        child_at: [-0.05, 0, 0]
        axes: [{turn: -z, at: [-0.06, 0, 0]}, {slide: y, limits_m: [-0.1, 0.2]}]
        limits_deg: [[-30, 60], null]
  light_sensors:
    - {body: arm, position: [0.05, 0, 0], axis: [2, 0, 0], field_of_view_deg: 90}
"""


def test_all_kinds_of_joints_and_shapes_are_drawn():
    data = parse_yaml(TEXT)
    made = scene(data, HERE)
    bodies = {body["name"]: body for body in made["bodies"]}
    assert list(bodies) == ["cart", "cart/2", "hub", "arm"]
    assert bodies["hub"]["mesh"] is None and bodies["arm"]["mesh"] is not None
    ball = bodies["cart/2"]
    assert (ball["whole"], ball["entry"], ball["place"]) == ("cart", "cart", [0, 0, 0.1])
    # The middle of the ball, as a place in the cart's frame.
    np.testing.assert_allclose(np.array(ball["turned"]) @ -np.array(ball["frame"]), [0, 0, 0.1])
    turn, slide = bodies["arm"]["joint"]["axes"]
    assert (turn["kind"], slide["kind"]) == ("turn", "slide")
    np.testing.assert_allclose([turn["lower"], turn["upper"]], [-30, 60])
    np.testing.assert_allclose([slide["lower"], slide["upper"]], [-0.1, 0.2])
    np.testing.assert_allclose(turn["along"], [0, 0, -1])
    np.testing.assert_allclose(turn["at"], [-0.01, 0.05, 0], atol=1e-12)
    (eye,) = made["sights"]
    assert eye["along"] == [1, 0, 0] and np.isclose(eye["half_angle"], np.pi / 4)


def test_a_part_is_added_to_a_body_that_hangs_on_the_world():
    data = parse_yaml(TEXT)
    assert add_part(data, HERE, "cart", (0.1, 0, 0), (1, 0, 0), name="nose") == "nose"
    here = posed(data, HERE)
    np.testing.assert_allclose(here.origins[here.index("nose")], [0.1875, 0, 0])


def test_axes_of_a_mirrored_joint_are_separated_as_they_are_written():
    data = parse_yaml(TEXT)
    mirror(data, "hub")
    before = scene(data, HERE)
    separate(data, "{side}_hub")
    after = scene(data, HERE)
    right = next(x for x in data["creature"]["bodies"] if x["name"] == "right_arm")
    assert right["joint"]["axes"] == [
        {"turn": "z", "at": [-0.06, 0, 0]},
        {"slide": "-y", "limits_m": [-0.1, 0.2]},
    ]

    def joints(made: dict) -> dict:
        return {body["name"]: body["joint"] for body in made["bodies"] if body["joint"]}

    theirs = joints(after)
    for name, joint in joints(before).items():
        for one, other in zip(joint["axes"], theirs[name]["axes"], strict=True):
            np.testing.assert_allclose(one["along"], other["along"], atol=1e-6)
            np.testing.assert_allclose(one["at"], other["at"], atol=1e-6)


def test_the_quaternion_of_a_body_is_its_turn():
    data = parse_yaml(TEXT)
    data["creature"]["bodies"][2]["joint"]["rotation_deg"] = [10, 20, 30]
    x, y, z, w = scene(data, HERE)["bodies"][3]["turn"]
    matrix = np.array(euler_to_matrix(*np.radians([10, 20, 30])))
    assert np.isclose(2 * np.arccos(abs(w)), np.arccos((np.trace(matrix) - 1) / 2))
    axis = np.array([x, y, z]) / np.linalg.norm([x, y, z])
    np.testing.assert_allclose(matrix @ axis, axis, atol=1e-9)
