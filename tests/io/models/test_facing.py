"""The note about an imported animal that does not face +x."""

import pytest

from evo_cpg.creature.creature import Body, Creature, Joint, Material
from evo_cpg.creature.shapes import Box
from evo_cpg.io.models.mjcf_world import facing_note


def animal(size, **places):
    """Return a trunk of a given size, and bodies by name at places on it."""
    flesh = Material(1000.0, 0.0, 0.6, 0.6)
    axis = ((0.0, 0.0, 1.0),), (-1.0,), (1.0,)
    bodies = [
        Body(name, Box((0.05, 0.05, 0.05)), flesh, Joint("trunk", place, (0, 0, 0), *axis))
        for name, place in places.items()
    ]
    return Creature("animal", (Body("trunk", Box(size), flesh), *bodies))


@pytest.mark.parametrize(
    ("creature", "turn"),
    [
        (animal((0.4, 0.2, 0.1), FL_hip=(0.2, 0.1, 0), FR_hip=(0.2, -0.1, 0)), None),
        # Wider than long, but its names show the front.
        (animal((0.2, 0.6, 0.1), left_foot=(0, 0.3, 0), right_foot=(0, -0.3, 0)), None),
        (animal((0.2, 0.4, 0.1), FL_hip=(-0.1, 0.2, 0), FR_hip=(0.1, 0.2, 0)), "-90"),
        (animal((0.2, 0.4, 0.1), hip_Left=(0.1, 0.2, 0), hip_Right=(-0.1, 0.2, 0)), "90"),
        (animal((0.4, 0.2, 0.1), lhip=(0.2, -0.1, 0), rhip=(0.2, 0.1, 0)), "180"),
        # The fingers of a gripper do not show the front.
        (animal((0.6, 0.2, 0.1), l_finger=(0.3, -0.02, 0), r_finger=(0.3, 0.02, 0)), None),
        (animal((0.1, 0.1, 0.1), tail=(0, -0.3, 0)), "-90 if it faces +y, or 90 if it faces -y"),
        (animal((0.3, 0.4, 0.1)), None),
    ],
)
def test_the_note_turns_the_front_to_x(creature, turn):
    note = facing_note(creature)
    if turn is None:
        assert note is None
    else:
        assert note is not None and note.endswith(f"simulation.start_heading_deg: {turn}")
