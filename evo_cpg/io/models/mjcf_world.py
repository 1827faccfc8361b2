"""World, trial, controller and task of an imported animal.

| in MJCF | becomes |
|---|---|
| ``gravity`` | ``world.gravity``, after the world is turned (`compiled`) |
| ``density`` of the medium, ``viscosity``, ``wind`` | ``world.water`` |
| ``gravcomp`` of all bodies | buoyancy; less gravity if it is equal and no liquid is there |
| a ``plane`` that the animal can touch | ``world.ground`` (`mjcf_contact`) |
| height of the animal above the ground | ``simulation.start_clearance`` |

Controller, task and search are defaults that can be trained at once: every axis gets an oscillator,
and the fitness is the displacement.
"""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.io.models.compiled import Compiled, tidy
from evo_cpg.io.models.mjcf_shapes import Placed
from evo_cpg.io.models.refusals import Refusal

# Densities (kg/m^3) above which a medium is a liquid. Drag of thinner ones is left out.
_LIQUID = 100.0

# Angle that motors with a spring follow at full output, degrees.
_ANGLE_RANGE = 40.0

# Smallest coefficient of gravity compensation that differs from 0, and tolerance of equal ones.
_ALIKE = 1e-6

# Smallest ratio of the length along y to the length along x of an animal that may face y, if its
# names do not say where its left side is.
_LONGER = 1.5

# Smallest mean distance between left and right bodies, as a fraction of the animal's size. The
# fingers of a gripper are nearer to each other, and do not show the front.
_APART = 0.1

# Largest angle from the x axis of an animal that faces +x, degrees.
_AHEAD = 45.0

# Words for the right side in place of words for the left one.
_RIGHT = {"l": "r", "L": "R", "left": "right", "Left": "Right", "LEFT": "RIGHT"}


def read_world(
    compiled: Compiled, placed: Sequence[Placed], volumes: Sequence[float], ground: Any
) -> dict[str, Any]:
    """Return the keys of the world.

    ``volumes`` are those of all shapes of each body, m^3.
    """
    model = compiled.model
    downward = -float(model.opt.gravity[2])
    if not np.isfinite(model.opt.gravity).all():
        compiled.refusals.add(Refusal("option", "its gravity holds no numbers", vital=True))
    gravity = 0.0 if compiled.disabled("gravity") else downward
    density = float(model.opt.density)
    carried = 0.0
    if gravity:
        gravity, carried = _compensated(compiled, placed, volumes, gravity, density >= _LIQUID)
    world: dict[str, Any] = {"gravity": tidy(gravity), "water": None}
    if carried and density and not np.isclose(carried, density, rtol=1e-3):
        compiled.refusals.leave_out(f"drag of the medium (density {density:g})")
        density = 0.0
    if 0 < density < _LIQUID:
        compiled.refusals.leave_out(f"drag of the medium (density {density:g})")
    elif density or carried:
        if not carried and gravity:
            compiled.refusals.leave_out(
                "that MuJoCo's medium carries no weight: water here has buoyancy"
            )
        viscosity = float(model.opt.viscosity)
        water: dict[str, Any] = {"density": tidy(carried or density)}
        if viscosity:
            water["viscosity"] = tidy(viscosity)
        if np.any(model.opt.wind):
            water["current"] = [tidy(float(x)) for x in model.opt.wind]
        world["water"] = water
    elif float(model.opt.viscosity):
        compiled.refusals.leave_out(f"viscosity of the medium ({model.opt.viscosity:g})")
    elif np.any(model.opt.wind):
        compiled.refusals.leave_out("option wind")
    if ground:
        world["ground"] = ground
    return world


def experiment(
    name: str,
    creature: dict[str, Any],
    world: dict[str, Any],
    clearance: float,
    displaced: bool,
    springs: bool,
) -> dict[str, Any]:
    """Return the keys of an experiment with a default controller, task and search.

    The animal starts at a ``clearance`` above the ground (m). It is ``displaced`` if its root can
    move, and has ``springs`` if a motor follows angles.
    """
    simulation: dict[str, Any] = {"control_rate_hz": 60, "substeps": 4, "seconds": 10}
    if clearance > _ALIKE:
        simulation["start_clearance"] = tidy(clearance)
    walks = bool(world.get("ground")) and world["gravity"] > 0 and displaced
    task = {"type": "walk", "heading": "forward"} if walks else {"type": "distance"}
    if not walks and displaced:
        task["heading"] = "forward"
    controller: dict[str, Any] = {
        "type": "brain_cpg",
        "drive": "per_joint",
        "brain": {"hidden": [8]},
        "cpg": {"pair_weight": 3.0, "parent_weight": 0.35, "child_weight": 0.1},
    }
    if springs:
        controller["angle_range_deg"] = _ANGLE_RANGE
    return {
        "name": name,
        "creature": creature,
        "world": world,
        "simulation": simulation,
        "controller": controller,
        "task": task,
        "evolution": {"generations": 50, "population": 100},
    }


def _compensated(
    compiled: Compiled,
    placed: Sequence[Placed],
    volumes: Sequence[float],
    gravity: float,
    floats: bool,
) -> tuple[float, float]:
    """Return gravity (m/s^2) and the density of a fluid that carries all bodies (kg/m^3).

    If the medium is a liquid (``floats``), equal lifts are buoyancy, and not less gravity.
    """
    model = compiled.model
    moving = [i for i, body in enumerate(placed) if body.rigid.joints or body.rigid.free]
    members = [list(placed[i].rigid.members) for i in moving]
    lifts = np.array([sum(model.body_gravcomp[own] * model.body_mass[own]) for own in members])
    if not lifts.any():
        return gravity, 0.0
    masses = np.array([sum(model.body_mass[own]) for own in members])
    spaces = np.array([volumes[i] for i in moving])
    with np.errstate(divide="ignore", invalid="ignore"):
        fluid = lifts / spaces
    alike = np.isfinite(fluid).all() and np.ptp(fluid) < _ALIKE * fluid.max() and fluid[0] > 0
    fractions = lifts / masses
    even = np.ptp(fractions) < _ALIKE and fractions[0] <= 1
    if alike and (floats or not even):
        return gravity, float(fluid[0])
    if even:
        return gravity * (1 - float(fractions[0])), 0.0
    lead = placed[moving[int(np.argmax(np.abs(lifts)))]].rigid.lead
    compiled.item("body", lead).refuse(
        "its gravcomp is not the buoyancy of a fluid around all bodies",
        "gravcomp in inverse proportion to the density, equal for all bodies, or none",
    )
    return gravity, 0.0


def facing_note(creature: Creature) -> str | None:
    """Return a sentence about an animal that probably does not face +x, or None.

    Bodies whose names differ only in left and right, such as ``FL_foot`` and ``FR_foot``, show the
    animal's left side. Without such names, its longest direction counts.
    """
    centres, turns = map(np.asarray, neutral_pose(creature))
    names = [body.name for body in creature.bodies]
    sides = []
    for i, name in enumerate(names):
        for found in re.finditer("left|l", name, re.IGNORECASE):
            other = _RIGHT.get(found[0], found[0])
            partner = name[: found.start()] + other + name[found.end() :]
            if partner != name and partner in names:
                sides.append(centres[i, :2] - centres[names.index(partner), :2])
    x, y = np.mean(sides, axis=0) if sides else (0.0, 0.0)
    half = np.array([body.shape.half_extents for body in creature.bodies])
    reach = np.einsum("bij,bj->bi", np.abs(turns), half)
    lengths = (centres + reach).max(0) - (centres - reach).min(0)
    if np.hypot(x, y) > _APART * lengths.max():
        # The front is a quarter of a turn to the right of the left side.
        front = float(np.rad2deg(np.arctan2(-x, y)))
        if abs(front) <= _AHEAD:
            return None
        seen = "the names of left and right bodies show that the animal does not face +x"
        turn = f"{-90 * round(front / 90) or 180}"
    elif lengths[1] <= _LONGER * lengths[0]:
        return None
    else:
        seen = f"the animal is {lengths[0]:.2g} m long along x, but {lengths[1]:.2g} m along y"
        turn = "-90 if it faces +y, or 90 if it faces -y"
    return (
        f"{seen}. The task rewards displacement along +x. To turn the animal at the start, set "
        f"simulation.start_heading_deg: {turn}"
    )
