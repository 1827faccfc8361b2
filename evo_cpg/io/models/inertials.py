"""Masses and inertias of a URDF, some of which MuJoCo's compiler would replace.

The compiler weighs links by their shapes, raises small numbers, and replaces moments that break the
triangle rule by their mean. It therefore gets placeholders, and the compiled model gets the file's
values. A body is a link and the links that are fixed to it. Its values change if no body can have
them:

| in the file | becomes |
|---|---|
| a link without ``inertial`` | 0 kg |
| a body of 0 kg | 1e-6 kg |
| a principal moment of 0 | 1e-9 kg m^2, but at most that of a thin rod |
| a moment that exceeds the sum of the others | the nearest moments that do not |

Each change is recorded with the old and the new value.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.io.models.refusals import Refusal, Refusals

# Mass (kg) and moment of inertia (kg m^2) of bodies without them.
_LEAST_MASS, _LEAST_MOMENT = 1e-6, 1e-9

# Smallest moment in place of 0, relative to the largest one. The radius of a rod with such moments
# is 1.3 % of its length.
_THIN = 1e-3

# Largest moment that counts as 0, relative to the largest one, because eigenvalues are rounded.
_ROUNDING = 1e-12

# Largest excess of a moment over the sum of the others, as a fraction of the sum, that is kept,
# because numbers in files are rounded. A configuration allows as much.
_EXCESS = 1e-6

# Placeholders of the centre of mass and the inertia. They have no symmetry, so that MuJoCo's
# compiler cannot simplify them, because both change after compiling.
_PLACE, _INERTIA = (0.1, 0.2, 0.3), (2.0, 2.5, 3.0, 0.1, 0.2, 0.3)


class Inertial(NamedTuple):
    """Mass properties of a link.

    Attributes:
        mass: mass, kg.
        place: centre of mass in the link's frame, m.
        turn: quaternion of the axes of the inertia in the link's frame.
        inertia: inertia about the centre of mass, kg m^2.
    """

    mass: float
    place: Float[np.ndarray, " 3"]
    turn: Float[np.ndarray, " 4"]
    inertia: Float[np.ndarray, "3 3"]


def set_inertials_aside(spec: Any, refusals: Refusals) -> dict[str, Inertial]:
    """Return the mass properties of links by name, and put placeholders in their place."""
    found = {}
    for body in spec.bodies[1:]:
        name = f"body {body.name!r}"
        mass, numbers = 0.0, np.zeros(6)
        if body.explicitinertial:
            mass, numbers = float(body.mass), np.array(body.fullinertia)
            # MuJoCo marks six zeros by NaN.
            numbers = numbers if numbers[1:].any() else np.nan_to_num(numbers)
        else:
            body.ipos = 0.0, 0.0, 0.0
            refusals.change(name, "mass none -> 0 kg, because it has no inertial")
        if not 0 <= mass < np.inf:
            problem = f"its mass is {mass:g} kg. Allowed: 0 or more"
            refusals.add(Refusal(name, problem, vital=True))
            mass = 0.0
        rounding = _EXCESS * max(_LEAST_MOMENT, np.abs(numbers).max())
        if not (np.isfinite(numbers).all() and numbers[:3].min() >= -rounding):
            words = ", ".join(f"{moment:g}" for moment in numbers[:3])
            problem = f"its moments of inertia are {words} kg m^2. Allowed: 0 or more"
            refusals.add(Refusal(name, problem, vital=True))
            numbers = np.zeros(6)
        xx, yy, zz, xy, xz, yz = numbers
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        found[body.name] = Inertial(mass, np.array(body.ipos), np.array(body.iquat), inertia)
        body.mass, body.ipos, body.iquat = 1.0, _PLACE, (1.0, 0.0, 0.0, 0.0)
        body.fullinertia, body.explicitinertial = _INERTIA, True
    return found


def restore_inertials(
    mujoco: Any, model: Any, inertials: Mapping[str, Inertial], refusals: Refusals
) -> None:
    """Set the mass properties of links in a compiled model, and make those of bodies possible."""
    for name, inertial in inertials.items():
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
        model.body_mass[body], model.body_ipos[body] = inertial.mass, inertial.place
        _set_inertia(mujoco, model, body, inertial.turn, inertial.inertia)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for lead in np.unique(model.body_weldid):
        members = [b for b in range(1, model.nbody) if model.body_weldid[b] == lead]
        if members:
            _make_possible(mujoco, model, data, members, refusals)


def mass_properties(
    model: Any, data: Any, members: Sequence[int]
) -> tuple[float, Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """Return mass (kg), centre of mass (m) and inertia about it (kg m^2) of several bodies.

    Args:
        model: the compiled model.
        data: places of its bodies.
        members: MuJoCo's numbers of the bodies.
    """
    members = list(members)
    masses = np.array(model.body_mass[members], float)
    mass = float(masses.sum())
    if not mass:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    places = np.array(data.xipos[members]).reshape(-1, 3)
    centre = masses @ places / mass
    inertia = np.zeros((3, 3))
    for member, own_mass, place in zip(members, masses, places, strict=True):
        axes = np.array(data.ximat[member]).reshape(3, 3)
        arm = place - centre
        inertia += axes @ np.diag(model.body_inertia[member]) @ axes.T
        inertia += own_mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return mass, centre, inertia


def possible_moments(moments: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Return the nearest principal moments, in ascending order, that a body can have."""
    largest = moments[-1]
    least = min(_LEAST_MOMENT, _THIN * largest) if largest > 0 else _LEAST_MOMENT
    found = np.where(moments > _ROUNDING * largest, moments, least)
    excess = found[2] - found[0] - found[1]
    if excess > _EXCESS * (found[0] + found[1]):
        # The shortest way to the plane on which the largest moment is the sum of the others.
        found += excess / 3 * np.array([1.0, 1.0, -1.0])
    return found


def _make_possible(
    mujoco: Any, model: Any, data: Any, members: Sequence[int], refusals: Refusals
) -> None:
    """Change the first link of a body so that the body has possible mass properties."""
    lead = members[0]
    name = f"body {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, lead)!r}"
    if not np.any(model.body_mass[members]):
        model.body_mass[lead] = _LEAST_MASS
        refusals.change(name, f"mass 0 -> {_LEAST_MASS:g} kg, because a body needs a mass")
    _, _, inertia = mass_properties(model, data, members)
    old, axes = np.linalg.eigh(inertia)
    new = possible_moments(old)
    if np.array_equal(old, new):
        return
    before, after = (", ".join(f"{moment:.9g}" for moment in each) for each in (old, new))
    refusals.change(name, f"principal moments of inertia {before} -> {after} kg m^2")
    frame = np.array(data.ximat[lead]).reshape(3, 3).T @ axes
    own = np.diag(model.body_inertia[lead]) + frame @ np.diag(new - old) @ frame.T
    _set_inertia(mujoco, model, lead, np.array(model.body_iquat[lead]), own)
    mujoco.mj_kinematics(model, data)


def _set_inertia(
    mujoco: Any,
    model: Any,
    body: int,
    turn: Float[np.ndarray, " 4"],
    inertia: Float[np.ndarray, "3 3"],
) -> None:
    """Set the inertia of a link, in axes that a quaternion turns."""
    model.body_inertia[body], axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.linalg.det(axes)
    principal = np.zeros(4)
    mujoco.mju_mat2Quat(principal, axes.ravel())
    mujoco.mju_mulQuat(model.body_iquat[body], turn, principal)
