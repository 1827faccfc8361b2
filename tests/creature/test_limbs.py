"""Limbs in contrast to trunks and tails."""

import dataclasses

from creatures import box_chain
from evo_cpg.creature.creature import Body, Creature, Joint, Material
from evo_cpg.creature.limbs import limbs
from evo_cpg.creature.shapes import Box


def leg(name: str, parent: str, place: tuple[float, float, float]) -> Body:
    joint = Joint(parent, place, (0.0, 0.0, 0.05), ((0.0, 1.0, 0.0),), (-1.0,), (1.0,))
    return Body(name, Box((0.04, 0.04, 0.1)), Material(1000.0), joint)


def names_of(creature: Creature) -> list[list[str]]:
    return [[creature.bodies[i].name for i in limb.bodies] for limb in limbs(creature)]


def test_a_tail_is_no_limb():
    assert limbs(box_chain(6, "z")) == ()


def test_legs_of_a_trunk_are_limbs_from_front_to_back():
    """Each leg has two bodies. The row of four boxes stays the trunk."""
    trunk = box_chain(4, "z")
    legs = []
    for segment in ("b2", "b0"):
        for side, y in (("right", -0.08), ("left", 0.08)):
            name = f"{segment}_{side}"
            legs += [
                leg(name, segment, (0.0, y, 0.0)),
                leg(f"{name}_foot", name, (0.0, 0.0, -0.05)),
            ]
    creature = dataclasses.replace(trunk, bodies=(*trunk.bodies, *legs))
    order = ("b0_left", "b0_right", "b2_left", "b2_right")
    assert names_of(creature) == [[name, f"{name}_foot"] for name in order]
    assert [limb.side for limb in limbs(creature)] == [1, -1, 1, -1]


def test_a_front_leg_in_the_median_plane_is_a_limb_beside_equal_legs():
    """A tripod: one leg in front and two behind. A single leg alone would be a tail."""
    body = Body("b", Box((0.3, 0.2, 0.1)), Material(1000.0))
    front = leg("front", "b", (0.15, 0.0, 0.0))
    behind = [leg(f"hind{k}", "b", (-0.1, y, 0.0)) for k, y in enumerate((-0.1, 0.1))]
    assert names_of(Creature("three", (body, front, *behind)))[0] == ["front"]
    assert limbs(Creature("one", (body, front))) == ()
