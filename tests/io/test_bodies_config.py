"""Bodies with parts, without a shape, and with mass and inertia in numbers, in YAML."""

import copy

import numpy as np
import pytest
from pydantic import ValidationError

from evo_cpg.creature.creature import CreatureError
from evo_cpg.creature.shapes import NoShape
from evo_cpg.io.build import build_creature
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.lint import lint
from evo_cpg.io.load import check_config, complete_config, load_config
from evo_cpg.io.schema.creature import CreatureConfig

BALL = {"type": "sphere", "radius": 0.1}
HINGE = {"parent": "head", "at": [-0.1, 0, 0], "child_at": [0.1, 0, 0], "axes": ["z"]}


def creature(**body) -> CreatureConfig:
    """Return a creature whose root has some keys."""
    root = {"name": "head", "shape": BALL, "material": "flesh"} | body
    tail = {"name": "tail", "shape": BALL, "material": "flesh", "joint": HINGE}
    materials = {"flesh": {"density": 1000.0}, "bone": {"density": 2000.0}}
    return CreatureConfig.model_validate(
        {"name": "c", "materials": materials, "bodies": [root, tail]}
    )


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ({"inertia": [1, 1, 1, 0, 0, 0]}, "inertia: needs mass, which is missing"),
        ({"mass": 1, "centre_of_mass": [0, 0, 0]}, "centre_of_mass: needs inertia"),
        ({"shape": None}, "mass: is missing, and a body without a shape"),
        ({"shape": None, "mass": 1}, "inertia: is missing, and a body without a shape"),
        ({"mass": 0}, "mass: must be positive, except for a body without a shape"),
        ({"mass": 1, "inertia": [1, 1, 1, 2, 0, 0]}, "inertia: .*positive, got -1, 1, 3"),
        ({"mass": 1, "inertia": [1, 1, 3, 0, 0, 0]}, "inertia: .*sum .*got 1, 1, 3"),
    ],
)
def test_masses_and_inertias_of_no_body_are_refused(body, words):
    with pytest.raises(ValidationError, match=words):
        creature(**body)


def test_a_flat_plate_has_the_largest_allowed_moment():
    """One moment of a plate is the sum of the others, up to the rounding of six digits."""
    creature(mass=1.0, inertia=[0.0123457, 0.0234568, 0.0358025001, 0, 0, 0])


def test_a_moving_body_needs_a_mass():
    given = creature(shape=None, mass=0)
    with pytest.raises(CreatureError, match="body 'head' moves, but neither it nor a body welded"):
        given.build()
    fixed = {"parent": "world", "at": [0, 0, 0], "child_at": [0, 0, 0], "axes": []}
    creature(shape=None, mass=0, joint=fixed).build()
    part = {"shape": BALL, "at": [0.2, 0, 0]}
    built = creature(shape=None, mass=0.5, parts=[part]).build()
    assert isinstance(built.bodies[0].shape, NoShape)
    assert [body.name for body in built.bodies] == ["head", "head/2", "tail"]
    assert built.bodies[0].mass == 0 and float(built.bodies[1].mass) == pytest.approx(0.5)


def test_a_creature_needs_a_shape():
    body = {"name": "a", "shape": None, "material": "m", "mass": 1, "inertia": [1, 1, 1, 0, 0, 0]}
    given = {"name": "c", "materials": {"m": {"density": 1.0}}, "bodies": [body]}
    with pytest.raises(ValidationError, match="bodies: no body has a shape"):
        CreatureConfig.model_validate(given)


def test_a_mass_alone_sets_one_density():
    """All shapes get the mass over the sum of their volumes."""
    box = {"type": "box", "size": [0.1, 0.1, 0.1]}
    part = {"shape": box, "at": [0, 0, 0.2], "material": "bone"}
    head, box, _ = creature(mass=3.0, parts=[part]).build().bodies
    assert float(head.mass + box.mass) == pytest.approx(3.0)
    assert float(head.material.density) == pytest.approx(float(box.material.density))


def test_a_creature_error_names_the_entry_of_the_body():
    config = load_config("configs/hexapod.yaml").model_dump(mode="json")
    bodies = config["creature"]["bodies"]
    bodies[0]["parts"] = [{"shape": BALL, "at": [0, 0, 0.2]}]
    bodies[1] |= {"shape": None, "mass": 0}
    with pytest.raises(ConfigError, match=r"creature\.bodies\.1\.mass: .* moves, but neither"):
        build_creature(check_config(config, "c.yaml"), "c.yaml")


def test_parts_and_numbers_give_no_warnings():
    """A leg without a shape, with its mass in numbers, is as plausible as before."""
    config = load_config("configs/hexapod.yaml").model_dump(mode="json")
    bodies = config["creature"]["bodies"]
    bodies[0]["parts"] = [{"shape": BALL, "at": [0, 0, 0.2]}]
    bodies[1] |= {"shape": None, "mass": 0.1, "inertia": [1e-3, 1e-3, 1e-3, 0, 0, 0]}
    checked = check_config(config, "c.yaml")
    assert lint(checked, "c.yaml") == []


def test_names_in_self_collision_stand_for_all_parts():
    given = creature(parts=[{"shape": BALL, "at": [0, 0, 0.2]}]).model_dump()
    given["self_collision"] = {"exclude": [["head", "tail"]]}
    config = CreatureConfig.model_validate(given)
    rule = config.build_self_collision(on_ground=True)
    assert rule is not None and rule.exclude == (("head", "tail"), ("head/2", "tail"))


def test_meshes_of_parts_are_read_from_files(tmp_path):
    """The path is relative to the file. The part keeps the frame of its mesh."""
    import trimesh

    trimesh.creation.box((0.1, 0.2, 0.3), np.eye(4)).apply_translation([1, 0, 0]).export(
        tmp_path / "box.stl"
    )
    config = copy.deepcopy(load_config("configs/hexapod.yaml").model_dump(mode="json"))
    mesh = {"type": "mesh", "file": "box.stl"}
    config["creature"]["bodies"][0]["parts"] = [{"shape": mesh, "at": [0, 0, 0.5]}]
    found = complete_config(config, tmp_path / "c.yaml").creature.build().bodies[1]
    assert found.whole is not None and found.joint is not None
    assert found.joint.parent_anchor == (0.0, 0.0, 0.5)
    np.testing.assert_allclose(found.joint.child_anchor, [-1.0, 0.0, 0.0], atol=1e-6)
