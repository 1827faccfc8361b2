"""Commands: animals from nothing, and edits that keep a body valid."""

import json
from pathlib import Path

import numpy as np
import pytest

from evo_cpg.creature.creature import neutral_pose
from evo_cpg.io.load import load_config
from evo_cpg.io.yaml_text import parse_yaml
from evo_cpg.view.drawing_page.commands import edit
from evo_cpg.view.drawing_page.document import Document, EditError
from evo_cpg.view.drawing_page.lookup import posed
from evo_cpg.view.drawing_page.session import problems

CONFIGS = Path(__file__).parents[3] / "configs"

# Sixty lists, each in another.
DEEP = json.loads("[" * 60 + "]" * 60)


@pytest.fixture
def animal(tmp_path) -> Document:
    return Document.new(tmp_path / "animal.yaml")


def do(document: Document, command: str, **given):
    return document.apply(edit(command, document.path, given))


def centres(document: Document) -> dict[str, np.ndarray]:
    creature = posed(document.data, document.path).creature
    places = np.round(np.asarray(neutral_pose(creature)[0]), 6)
    return dict(zip([body.name for body in creature.bodies], places, strict=True))


def errors(document: Document, thorough: bool = False) -> list[str]:
    found = problems(document.data, document.path, thorough)
    return [each.words for each in found if each.kind == "error"]


def with_legs(animal: Document) -> None:
    """A body on four legs of two parts."""
    for name, x in (("fore", 0.08), ("hind", -0.08)):
        do(animal, "add_part", parent="body", place=[x, 0.05, 0], normal=[0, 0, -1],
           name=f"{name}thigh")  # fmt: skip
        thigh = parse_yaml(animal.texts.main)["creature"]["bodies"][-1]["name"]
        do(animal, "mirror", name=thigh)
        do(animal, "add_part", parent=f"right_{name}thigh", place=[0.075, 0, 0], normal=[1, 0, 0],
           name=f"{name}shin")  # fmt: skip


def test_the_swimmer_of_the_paper_is_drawn_from_nothing(animal):
    """Ten boxes in series, as in the file that comes with the program."""
    do(animal, "rename_part", name="body", new="head")
    do(animal, "add_part", parent="head", place=[-0.1, 0, 0], normal=[-1, 0, 0], name="segment",
       shape={"type": "box", "size": [0.2, 0.1, 0.1]})  # fmt: skip
    do(animal, "repeat", name="segment", count=9)
    do(animal, "set_joint", name="segment{i}", key="axes", value=["x", "y", "z"])
    do(animal, "set_joint", name="segment{i}", key="limits_deg", value=[-60, 60])
    do(animal, "set_joint", name="segment{i}", key="actuator", value={"gain": 100})
    do(animal, "set_joint", name="segment{i}", key="child_at", value=[0.11, 0, 0])
    do(animal, "shift", part="segment1", by=[-0.01, 0, 0])
    do(animal, "add_eye", part="head", place=[0.1, 0, 0], axis=[1, 0, 0])
    do(animal, "set_value", key=["creature", "materials", "body"], value={"density": 1000})
    for i in range(2):
        do(animal, "set_value", key=["creature", "bodies", i, "material"], value="body")
    do(animal, "unset_value", key=["creature", "materials", "flesh"])
    do(animal, "set_value", key=["creature", "name"], value="swimmer10")
    animal.save()
    theirs = load_config(CONFIGS / "iwadate2010_swimmer.yaml").creature
    assert load_config(animal.path).creature == theirs
    assert Document.open(animal.path).texts == animal.texts
    assert problems(animal.data, animal.path) == []


def test_a_four_legged_animal_is_drawn_from_nothing(animal):
    with_legs(animal)
    do(animal, "set_water", on=False)
    do(animal, "set_ground", on=True)
    do(animal, "set_value", key=["task"], value={"type": "walk"})
    places = centres(animal)
    assert len(places) == 9
    for name in ("forethigh", "foreshin", "hindthigh", "hindshin"):
        left, right = places[f"left_{name}"], places[f"right_{name}"]
        np.testing.assert_allclose(left * [1, -1, 1], right, atol=1e-6)
        assert left[1] > 0 and left[2] < -0.05
    assert "mirror: y" in animal.texts.main and animal.texts.main.count("mirror") == 2
    animal.save()
    assert Document.open(animal.path).texts == animal.texts
    assert errors(animal, thorough=True) == []


def test_a_part_stands_on_the_surface_along_its_normal(animal):
    do(animal, "add_part", parent="body", place=[0, 0.05, 0.01], normal=[0, 1, 1], name="fin")
    place, reach = centres(animal)["fin"], 0.0875
    expected = np.array([0, 0.05, 0.01]) + reach * np.array([0, 1, 1]) / np.sqrt(2)
    np.testing.assert_allclose(place, expected, atol=1e-4)


def test_a_shift_and_a_turn_of_a_copy_move_all_copies(animal):
    do(animal, "add_part", parent="body", place=[0, -0.05, 0], normal=[0, -1, 0], name="fin")
    do(animal, "mirror", name="fin")
    before = centres(animal)
    do(animal, "shift", part="right_fin", by=[0.01, -0.02, 0.03])
    after = centres(animal)
    np.testing.assert_allclose(after["right_fin"] - before["right_fin"], [0.01, -0.02, 0.03])
    np.testing.assert_allclose(after["left_fin"] - before["left_fin"], [0.01, 0.02, 0.03])
    # Its x axis points ahead, as the body's.
    do(animal, "turn", part="right_fin", rotation=np.eye(3).tolist())
    here = posed(animal.data, animal.path)
    np.testing.assert_allclose(here.rotations[here.index("right_fin")], np.eye(3), atol=1e-9)
    np.testing.assert_allclose(here.rotations[here.index("left_fin")], np.eye(3), atol=1e-9)


def test_a_star_is_shifted_along_its_own_ray(animal):
    do(animal, "add_part", parent="body", place=[0.1, 0, 0], normal=[1, 0, 0], name="ray")
    do(animal, "radial", name="ray", count=4)
    before = centres(animal)
    do(animal, "shift", part="ray_2", by=[0, 0.01, 0])
    moved = {name: place - before[name] for name, place in centres(animal).items()}
    np.testing.assert_allclose(moved["ray_2"], [0, 0.01, 0], atol=1e-6)
    np.testing.assert_allclose(moved["ray_1"], [0.01, 0, 0], atol=1e-6)
    do(animal, "add_part", parent="ray_1", place=[0.1, 0, 0], normal=[1, 0, 0], name="tip")
    assert "tip4" in centres(animal)
    do(animal, "radial", name="ray_{j}", count=1)
    assert set(centres(animal)) == {"body", "ray_1", "tip1"}


def test_separate_copies_stay_where_they_are(animal):
    with_legs(animal)
    do(animal, "add_eye", part="left_foreshin", place=[0, 0.01, 0], axis=[0, 1, 0])
    before = posed(animal.data, animal.path)
    do(animal, "separate", name="{side}_forethigh")
    after = posed(animal.data, animal.path)
    assert "left_forethigh" in [entry.name for entry in after.config.bodies]
    for i, body in enumerate(before.copies):
        k = after.index(body.name)
        np.testing.assert_allclose(after.origins[k], before.origins[i], atol=1e-4)
        np.testing.assert_allclose(after.rotations[k], before.rotations[i], atol=1e-4)
    eyes = [(eye.body, *np.round(eye.axis, 6)) for eye in after.creature.light_sensors]
    assert eyes == [("left_foreshin", 0, 1, 0), ("right_foreshin", 0, -1, 0)]
    assert "left_hindthigh" not in [entry.name for entry in after.config.bodies]


def test_a_row_carries_its_parts_on_its_last_body(animal):
    do(animal, "add_part", parent="body", place=[-0.1, 0, 0], normal=[-1, 0, 0], name="tail",
       shape={"type": "box", "size": [0.2, 0.1, 0.1]})  # fmt: skip
    do(animal, "add_part", parent="tail", place=[-0.1, 0, 0], normal=[-1, 0, 0], name="fin")
    for count, last in ((3, "tail3"), (5, "tail5"), (2, "tail2")):
        do(animal, "repeat", name="tail" if count == 3 else "tail{i}", count=count)
        fin = next(x for x in posed(animal.data, animal.path).copies if x.name == "fin")
        assert fin.parent == last


def test_a_further_shape_stands_on_the_surface_of_its_body(animal):
    do(animal, "add_part", parent="body", place=[0, -0.05, 0], normal=[0, -1, 0], name="fin")
    do(animal, "mirror", name="fin")
    ball = {"type": "sphere", "radius": 0.01}
    do(animal, "add_shape", part="right_fin", place=[0.08, -0.02, 0], normal=[0, -1, 0], shape=ball)
    before = centres(animal)
    assert list(before) == ["body", "left_fin", "left_fin/2", "right_fin", "right_fin/2"]
    # The right fin points along -y, so its own -y is behind it.
    offset = before["right_fin/2"] - before["right_fin"]
    np.testing.assert_allclose(offset, [-0.03, -0.08, 0], atol=1e-6)
    do(animal, "separate", name="{side}_fin")
    for name, place in centres(animal).items():
        np.testing.assert_allclose(place, before[name], atol=1e-6)
    do(animal, "stretch", name="left_fin", factors=[2, 1, 1])
    further = animal.data["creature"]["bodies"][1]["parts"]
    assert further[0]["at"] == [0.16, 0.03, 0]
    do(animal, "remove_shape", name="left_fin", index=0)
    assert "left_fin/2" not in centres(animal)


def test_tendons_follow_the_names_of_their_joints(animal):
    do(animal, "add_part", parent="body", place=[-0.1, 0, 0], normal=[-1, 0, 0], name="tail")
    do(animal, "add_part", parent="tail", place=[-0.1, 0, 0], normal=[-1, 0, 0], name="fin")
    tendon = {"name": "cord", "joints": {"tail.y": 1, "fin.z": -1}, "stiffness": 1}
    do(animal, "set_value", key=["creature", "tendons"], value=[tendon])
    do(animal, "rename_part", name="tail", new="stem")
    assert animal.data["creature"]["tendons"][0]["joints"] == {"stem.y": 1, "fin.z": -1}
    assert errors(animal) == []
    do(animal, "remove_part", name="fin")
    assert animal.data["creature"]["tendons"][0]["joints"] == {"stem.y": 1}
    do(animal, "remove_part", name="stem")
    assert animal.data["creature"]["tendons"] == []


def test_separate_copies_keep_what_refers_to_them(animal):
    do(animal, "add_part", parent="body", place=[0, 0.05, 0], normal=[0, 1, 0], name="fin")
    do(animal, "mirror", name="fin")
    side = {"name": "{side}", "joints": {"{side}_fin.z": 0.5}, "stiffness": 1}
    both = {"name": "both", "joints": {"{side}_fin.y": 1}, "damping": 1}
    for key, value in {
        "pressure_sensors": ["{side}_fin"],
        "self_collision": {"include": [["{side}_fin", "all"]]},
        "tendons": [side, both],
    }.items():
        do(animal, "set_value", key=["creature", key], value=value)
    before = posed(animal.data, animal.path)
    do(animal, "separate", name="left_fin")
    assert errors(animal) == []
    after = posed(animal.data, animal.path)
    assert after.creature.tendons == before.creature.tendons and len(after.creature.tendons) == 3
    assert after.creature.pressure_sensors == before.creature.pressure_sensors
    rules = [each.config.build_self_collision(False) for each in (before, after)]
    assert rules[0] == rules[1] and rules[0] and len(rules[0].include) == 4


def test_a_part_stands_on_a_body_without_own_shape(animal):
    further = {"shape": {"type": "box", "size": [0.1, 0.1, 0.1]}, "at": [0, 0, 0]}
    do(animal, "set_value", key=["creature", "bodies", 0, "parts"], value=[further])
    do(animal, "set_value", key=["creature", "bodies", 0, "mass"], value=1)
    do(animal, "set_value", key=["creature", "bodies", 0, "shape"], value=None)
    do(animal, "add_part", parent="body", place=[0.05, 0, 0], normal=[1, 0, 0], name="nose")
    do(animal, "add_shape", part="body", place=[0, 0, 0.05], normal=[0, 0, 1])
    assert errors(animal) == []
    assert animal.data["creature"]["bodies"][1]["shape"]["radius"] == 0.025
    bare = {"shape": None, "parts": [], "inertia": [1, 1, 1, 0, 0, 0]}
    for key, value in bare.items():
        do(animal, "set_value", key=["creature", "bodies", 0, key], value=value)
    with pytest.raises(EditError, match="body has no shape, so it has no surface"):
        do(animal, "add_shape", part="body", place=[0, 0, 0.05], normal=[0, 0, 1])


def test_a_row_of_another_size_follows_its_first_body(animal):
    do(animal, "add_part", parent="body", place=[-0.1, 0, 0], normal=[-1, 0, 0], name="tail",
       shape={"type": "box", "size": [0.06, 0.04, 0.04]})  # fmt: skip
    do(animal, "add_part", parent="tail", place=[-0.03, 0, 0], normal=[-1, 0, 0], name="fin")
    do(animal, "repeat", name="tail", count=3)
    places = centres(animal)
    assert list(places) == ["body", "tail", "tail_1", "tail_2", "fin"]
    np.testing.assert_allclose(
        [places[name][0] for name in ("tail", "tail_1", "tail_2")], [-0.13, -0.19, -0.25]
    )
    assert places["fin"][0] < -0.28
    kinds = [each.kind for each in problems(animal.data, animal.path) if each.part]
    assert kinds == []


def test_a_stretched_part_keeps_what_is_on_its_surface(animal):
    do(animal, "add_part", parent="body", place=[0.1, 0, 0], normal=[1, 0, 0], name="nose")
    do(animal, "add_eye", part="body", place=[0.1, 0, 0], axis=[1, 0, 0])
    do(animal, "stretch", name="body", factors=[2, 1, 1])
    creature = animal.data["creature"]
    assert creature["bodies"][0]["shape"]["size"] == [0.4, 0.1, 0.1]
    assert creature["bodies"][1]["joint"]["at"] == [0.2, 0, 0]
    assert creature["light_sensors"][0]["position"] == [0.2, 0, 0]
    do(animal, "resize", name="body", key="size", value=[0.5, 0.1, 0.1])
    assert animal.data["creature"]["bodies"][1]["joint"]["at"] == [0.25, 0, 0]
    axes = ["y", {"turn": "z", "at": [-0.06, 0, 0]}]
    do(animal, "set_joint", name="nose", key="axes", value=axes)
    do(animal, "stretch", name="nose", factors=[2, 1, 1])
    assert animal.data["creature"]["bodies"][1]["joint"]["axes"][1]["at"] == [-0.12, 0, 0]
    do(animal, "set_shape", name="nose", type="ellipsoid")
    assert centres(animal)["nose"][0] > 0.2


def test_sections_of_a_loft_are_added_moved_scaled_and_mirrored(animal):
    do(animal, "set_shape", name="body", type="loft")
    key = ["creature", "bodies", 0, "shape", "sections"]

    def sections():
        return animal.data["creature"]["bodies"][0]["shape"]["sections"]

    assert [each["at"] for each in sections()] == [[0.1, 0, 0], [0, 0, 0], [-0.1, 0, 0]]
    do(animal, "add_section", name="body", after=0)
    assert sections()[1] == {"at": [0.05, 0, 0], "width": 0.075, "height": 0.075}
    do(animal, "set_value", key=[*key, 3, "width"], value=0)
    # The tip moves to the new end.
    do(animal, "add_section", name="body", after=3)
    assert [each["width"] for each in sections()] == [0.05, 0.075, 0.1, 0.05, 0]
    assert sections()[4]["at"] == [-0.2, 0, 0]
    do(animal, "scale_section", part="body", index=1, factors=[2, 0.5])
    assert (sections()[1]["width"], sections()[1]["height"]) == (0.15, 0.0375)
    do(animal, "stretch", name="body", factors=[2, 1, 0.5])
    assert sections()[1] == {"at": [0.1, 0, 0], "width": 0.15, "height": 0.01875}
    do(animal, "remove_section", name="body", index=4)
    do(animal, "set_shape", name="body", type="box")
    size = animal.data["creature"]["bodies"][0]["shape"]["size"]
    np.testing.assert_allclose(size, [0.4, 0.15, 0.05], rtol=0.02)

    shape = {"type": "loft", "sections": [
        {"at": [0.05, 0.01, 0], "width": 0.04, "height": 0.01},
        {"at": [-0.05, 0, 0], "width": 0.02, "height": 0}]}  # fmt: skip
    do(animal, "add_part", parent="body", place=[0, -0.07, 0], normal=[0, -1, 0], name="fin",
       shape=shape)  # fmt: skip
    do(animal, "mirror", name="fin")
    assert animal.data["creature"]["bodies"][1]["shape"]["sections"][0]["at"] == [0.05, -0.01, 0]
    before = centres(animal)
    do(animal, "move_section", part="right_fin", index=0, by=[0.01, -0.02, 0.03])
    after = centres(animal)
    moved = {side: after[f"{side}_fin"] - before[f"{side}_fin"] for side in ("left", "right")}
    np.testing.assert_allclose(moved["left"] * [1, -1, 1], moved["right"], atol=1e-5)
    assert moved["right"][1] < 0 < moved["right"][2]
    assert errors(animal, thorough=True) == []


def test_values_of_each_axis_follow_their_axis(animal):
    do(animal, "add_part", parent="body", place=[-0.1, 0, 0], normal=[-1, 0, 0], name="tail")

    def joint():
        return animal.data["creature"]["bodies"][1]["joint"]

    muscle = {"type": "muscle", "area": 1e-4, "arm": 0.01, "fibre_length": 0.05}
    do(animal, "set_joint", name="tail", key="limits_deg", value=[[-10, 10], [-20, 20]])
    do(animal, "set_joint", name="tail", key="actuator", value=[None, muscle])
    do(animal, "set_joint", name="tail", key="damping", value=[1, 2])
    do(animal, "set_axes", name="tail", axes=["x", "z", "y"], kept=[None, 1, 0])
    assert joint()["limits_deg"] == [[-10, 10], [-20, 20], [-10, 10]]
    assert joint()["actuator"] == [muscle, muscle, None] and joint()["damping"] == [1, 2, 1]
    do(animal, "set_axes", name="tail", axes=["x", {"slide": "z"}, "y"])
    assert joint()["limits_deg"][1] is None and joint()["actuator"][1] == {"gain": 1}
    assert errors(animal, thorough=True) == []
    do(animal, "set_axes", name="tail", axes="ball")
    assert joint()["limits_deg"] == [0, 10] and joint()["actuator"] == {"gain": 1}
    assert joint()["damping"] == 1
    assert errors(animal, thorough=True) == []
    do(animal, "set_axes", name="tail", axes=["z"])
    assert joint()["limits_deg"] == [-10, 10]
    do(animal, "set_axes", name="tail", axes=[])
    assert posed(animal.data, animal.path).creature.bodies[1].joint.dofs == ()


def test_removed_parts_leave_no_reference(animal):
    with_legs(animal)
    do(animal, "add_eye", part="right_foreshin", place=[0, 0, 0], axis=[1, 0, 0])
    do(animal, "set_pressure", part="body", on=False)
    pair = ["{side}_foreshin", "body"]
    rule = {"exclude": [pair, ["body", "{side}_hindshin"]]}
    do(animal, "set_value", key=["creature", "self_collision"], value=rule)
    do(animal, "remove_part", name="left_forethigh")
    creature = animal.data["creature"]
    assert [entry["name"] for entry in creature["bodies"]] == [
        "body", "{side}_hindthigh", "{side}_hindshin"
    ]  # fmt: skip
    assert creature["light_sensors"] == []
    assert creature["self_collision"]["exclude"] == [["body", "{side}_hindshin"]]
    assert not any("fore" in name for name in creature["pressure_sensors"])
    do(animal, "set_pressure", part="body", on=True)
    assert animal.data["creature"]["pressure_sensors"] == "all"


@pytest.mark.parametrize(
    ("command", "given", "words"),
    [
        ("remove_part", {"name": "body"}, "is the root, which carries"),
        ("remove_part", {"name": "wing"}, "there is no part 'wing'"),
        ("remove_shape", {"name": "fin", "index": 0}, "fin has no further shape 0"),
        ("shift", {"part": "body", "by": [1, 0, 0]}, "is the root, to which"),
        ("mirror", {"name": "fin"}, "its joint is in the mirror plane"),
        ("stretch", {"name": "fin", "factors": [1, 0, 1]}, "three positive numbers"),
        ("resize", {"name": "fin", "key": "size", "value": 1}, "its shape has no size 'size'"),
        ("rename_part", {"name": "fin", "new": "body"}, "another part has this name"),
        ("set_shape", {"name": "fin", "type": "torus"}, "'torus': choose one of box"),
        ("repeat", {"name": "fin", "count": 0}, "whole number from 1 to 1000, got 0"),
        ("turn", {"part": "fin", "rotation": [[1, 0, 0]] * 3}, "needs a rotation matrix"),
        ("remove_sensor", {"kind": "light_sensors", "index": 0}, "has no entry 0"),
        ("set_value", {"key": ["seed", "x", "y"], "value": 1}, None),
        ("set_value", {"key": ["seed"], "value": float("nan")}, "not read as it is written"),
        ("set_value", {"key": ["seed"], "value": DEEP}, "nested more than 50 levels"),
        ("set_value", {"key": ["creature", "bodies", 9, "name"], "value": 1}, "there is no 9"),
        ("add_part", {"parent": "fin"}, "add_part: place: is missing and has no default"),
        ("set_shape", {"name": "fin", "type": []}, "type: .*: must be text"),
        ("add_section", {"name": "fin", "after": 0}, "fin is no loft"),
        ("fly", {}, "there is no command 'fly'. Commands: add_part, "),
    ],
)
def test_an_impossible_edit_changes_nothing(animal, command, given, words):
    do(animal, "add_part", parent="body", place=[0, 0, 0.05], normal=[0, 0, 1], name="fin")
    texts = animal.texts
    if words is None:
        do(animal, command, **given)
        assert problems(animal.data, animal.path, thorough=False)[0].kind == "error"
        return
    with pytest.raises(EditError, match=words.replace("(", r"\(")):
        do(animal, command, **given)
    assert animal.texts == texts


def test_messages_name_the_part_that_they_are_about(animal):
    with_legs(animal)
    do(animal, "set_joint", name="{side}_foreshin", key="limits_deg", value=[0.5, -0.5])
    (found,) = problems(animal.data, animal.path)
    assert (found.kind, found.part) == ("error", "{side}_foreshin")
    assert "limits_deg" in found.words or "limits_deg" in found.key
    with pytest.raises(EditError, match=r"first mend creature\.bodies\.2\.joint"):
        do(animal, "shift", part="left_forethigh", by=[0, 0, 0.1])
    animal.undo()
    do(animal, "set_joint", name="{side}_foreshin", key="limits_deg", value=[-1.0472, 1.0472])
    found = [each for each in problems(animal.data, animal.path) if each.part]
    assert [(each.kind, each.part) for each in found] == [("warning", "{side}_foreshin")]
