"""Places that lie outside of what they belong to."""

from collections.abc import Iterator

import numpy as np

from evo_cpg.config.errors import Key
from evo_cpg.config.plausible.doubt import Case, Doubt
from evo_cpg.creature.shapes import Shape

# A place may stick out of its body by this share of the body's largest half extent: bodies are
# joined with gaps between them, and eyes stand on stalks.
_OUT = 0.3

# Bodies of a row that are each turned by so much against the one before it make a ring, degrees.
_CURLS = 45.0


def repeated_place(case: Case) -> Iterator[Doubt]:
    """A row whose joint fits the first body's parent, but not the bodies of the row themselves."""
    bodies = {body.name: body for body in case.creature.bodies}
    for key, entry, body in case.bodies():
        if entry.repeat == 1 or entry.joint is None or body.joint is None:
            continue
        parent, at = bodies[body.joint.parent], body.joint.parent_anchor
        fits, gap = _gap(parent.shape, at), _gap(body.shape, at)
        if abs(fits) > _OUT * parent.shape.half_extents.max():
            continue
        if abs(gap) > _OUT * body.shape.half_extents.max():
            side = "outside of" if gap > 0 else "inside"
            yield Doubt(
                (*key, "joint", "at"),
                entry.joint.at,
                f"repeat takes this place for every body of the row: on {parent.name!r}, on which "
                f"the first one hangs, it fits, but it lies {abs(gap):.3g} m {side} {body.name!r}, "
                "on which the next one hangs; give the first body an entry of its own",
            )


def repeated_turn(case: Case) -> Iterator[Doubt]:
    """A row that curls up: each of its bodies is turned against the one before it."""
    for key, entry, _ in case.bodies():
        angles = entry.joint.rotation_deg if entry.joint else ()
        most = max(map(abs, angles), default=0.0)
        if entry.repeat > 1 and most >= _CURLS:
            yield Doubt(
                (*key, "joint", "rotation_deg"),
                angles,
                f"repeat turns every body of the row by {most:g} degrees against the one before "
                f"it; plausible are less than {_CURLS:g}; to turn the row as a whole give the "
                "first body an entry of its own",
            )


def joint_anchor(case: Case) -> Iterator[Doubt]:
    """A joint that is nowhere near one of the bodies that it joins."""
    bodies = {body.name: body for body in case.creature.bodies}
    for key, entry, body in case.bodies():
        if entry.joint is None or body.joint is None:
            continue
        parent, joint = bodies[body.joint.parent], body.joint
        yield from _outside(
            (*key, "joint", "at"),
            entry.joint.at,
            f"body {parent.name!r}, on which {body.name!r} hangs",
            parent.shape,
            joint.parent_anchor,
        )
        yield from _outside(
            (*key, "joint", "child_at"),
            entry.joint.child_at,
            f"body {body.name!r} itself",
            body.shape,
            joint.child_anchor,
        )


def sensor_place(case: Case) -> Iterator[Doubt]:
    """An eye or a gauge that is nowhere near its body."""
    creature = case.creature
    for name in ("light_sensors", "depth_sensors"):
        for i, entry, sensor in case.sensors(name):
            yield from _outside(
                ("creature", name, i, "position"),
                entry.position,
                f"body {sensor.body!r}",
                creature.bodies[creature.body_index(sensor.body)].shape,
                sensor.position,
            )


def _gap(shape: Shape, place: tuple[float, float, float]) -> float:
    """Return the distance from a shape's surface to a place in its frame, m; negative inside."""
    return float(shape.distance(np.array([place]))[0])


def _outside(
    key: Key, value: object, whose: str, shape: Shape, place: tuple[float, float, float]
) -> Iterator[Doubt]:
    """Doubt a place, in the shape's own frame, that is too far outside of it."""
    half = shape.half_extents
    gap = _gap(shape, place)
    if gap <= _OUT * half.max():
        return
    x, y, z = half
    likely = "places count from the body's centre, so half its size reaches its surface"
    if gap > 100 * half.max():
        likely = "places are in m: is this in mm?"
    yield Doubt(
        key,
        value,
        f"lies {gap:.3g} m outside of {whose}, which reaches to {x:.3g}, {y:.3g}, {z:.3g} m; "
        f"{likely}",
    )


RULES = (repeated_place, repeated_turn, joint_anchor, sensor_place)
