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

from collections.abc import Sequence
from typing import Any

import numpy as np

from evo_cpg.io.models.compiled import Compiled, tidy
from evo_cpg.io.models.mjcf_shapes import Placed
from evo_cpg.io.models.refusals import Refusal

# Densities (kg/m^3) above which a medium is a liquid. Drag of thinner ones is left out.
_LIQUID = 100.0

# Angle that motors with a spring follow at full output, degrees.
_ANGLE_RANGE = 40.0

# Smallest coefficient of gravity compensation that differs from 0, and tolerance of equal ones.
_ALIKE = 1e-6


def read_world(
    compiled: Compiled,
    placed: Sequence[Placed],
    volumes: Sequence[float],
    ground: Any,
) -> dict[str, Any]:
    """Return the keys of the world.

    Args:
        compiled: the model.
        placed: bodies of the animal.
        volumes: volume of all shapes of each body, m^3.
        ground: keys of the ground, or None.
    """
    model = compiled.model
    gravity = _gravity(compiled)
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

    Args:
        name: name of the run.
        creature: keys of the creature.
        world: keys of the world.
        clearance: height of the animal above the ground at the start, m.
        displaced: whether the root can move.
        springs: whether a motor follows angles.
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


def _gravity(compiled: Compiled) -> float:
    """Return the downward acceleration, m/s^2."""
    if compiled.disabled("gravity"):
        return 0.0
    gravity = np.asarray(compiled.model.opt.gravity)
    if not np.isfinite(gravity).all():
        compiled.refusals.add(Refusal("option", "its gravity holds no numbers", vital=True))
    return -float(gravity[2])


def _compensated(
    compiled: Compiled,
    placed: Sequence[Placed],
    volumes: Sequence[float],
    gravity: float,
    floats: bool,
) -> tuple[float, float]:
    """Return gravity (m/s^2) and the density of a fluid that carries all bodies (kg/m^3).

    Args:
        compiled: the model.
        placed: bodies of the animal.
        volumes: volume of all shapes of each body, m^3.
        gravity: gravity of the file, m/s^2.
        floats: whether the medium is a liquid, so that equal lifts are buoyancy, not less gravity.
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
