"""Import of a MuJoCo model (MJCF) as a creature.

MuJoCo compiles the file, which resolves defaults, classes, includes, units and orientations. The
import reads the compiled model. It takes all parts that a creature can have. Parts that do not
affect its motion are left out, by name. Everything else is refused, by name:

| in MJCF | becomes | table |
|---|---|---|
| the body with a ``freejoint`` | the root, which stands in the world's axes | |
| one to three ``hinge``s of a body | the joint | `mjcf_joints` |
| one ``geom``, which gives the body its mass | the shape | `mjcf_shapes` |
| ``position``, ``velocity``, ``motor`` | the motor | `mjcf_motors` |
| first friction of the ``geom`` | static and dynamic friction | |
| any other field | refused or left out | `mjcf_fields` |
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from evo_cpg.config.schema.creature import BodyConfig, CreatureConfig, MaterialConfig
from evo_cpg.exchange.compiled import TOLERANCE, WORLD, Compiled, compile_model, make_section, tidy
from evo_cpg.exchange.mjcf_fields import (
    PLAIN_PAIR,
    counted,
    left_out_counts,
    left_out_options,
    refuse_elements,
    refuse_fields,
    require_numbers,
)
from evo_cpg.exchange.mjcf_joints import check_joints, joints_of, read_joint
from evo_cpg.exchange.mjcf_motors import command_ranges, read_motors
from evo_cpg.exchange.mjcf_shapes import Placed, only_geom, place_body, uniform_density
from evo_cpg.exchange.refusals import ExchangeError

# MuJoCo's colour of a geom without one.
_GREY = (0.5, 0.5, 0.5, 1.0)

# Flags that decide which bodies touch.
_OF_COLLISIONS = ("contact", "filterparent")

# Springs, dampers and rotors of the root against the world, by their field and their attribute.
_OF_ROOT = {"dof_damping": "damping", "dof_armature": "armature", "jnt_stiffness": "stiffness"}


class Imported(NamedTuple):
    """Result of reading a file.

    Attributes:
        creature: configuration of the creature.
        left_out: names of parts of the file that are not in the creature, because they belong to
            the world or do not affect the motion.
    """

    creature: CreatureConfig
    left_out: tuple[str, ...]


def read_mjcf(path: Path | str, motor_gain: float | None = None) -> Imported:
    """Read a creature from a file that MuJoCo can load.

    Args:
        path: the file.
        motor_gain: gain of the velocity servos that replace torque motors, N m s/rad, or None to
            keep torque motors.

    Raises:
        ExchangeError: MuJoCo is missing or cannot load the file, or a part of the file cannot be
            part of a creature.
    """
    compiled = compile_model(Path(path))
    model = compiled.model
    require_numbers(compiled)
    refuse_elements(compiled)
    refuse_fields(compiled)
    root = _find_root(compiled)
    motors = read_motors(compiled, motor_gain)
    names = _body_names(compiled)
    bodies = [i for i in range(root, model.nbody) if model.body_rootid[i] == root]
    placed, made_of = _read_shapes(compiled, bodies)
    for body in bodies[1:]:
        check_joints(compiled, body)
    fluid = 0.0
    if len(placed) == len(bodies):
        with compiled.refusals.collecting():
            fluid = _buoyancy(compiled, placed)
    compiled.refusals.check()
    materials: dict[MaterialConfig, str] = {}
    entries = []
    for body in bodies:
        material = materials.setdefault(made_of[body], f"material{len(materials) + 1}")
        entry = {"name": names[body], "shape": placed[body].shape, "material": material}
        entry["color"] = _color(model, int(model.body_geomadr[body]))
        with compiled.refusals.collecting():
            if body != root:
                entry["joint"] = read_joint(compiled, body, placed, names, motors)
            entries.append(compiled.item("body", body).section(BodyConfig, entry))
    compiled.refusals.check()
    name = _model_name(compiled)
    made = {name: made_of for made_of, name in materials.items()}
    whole = {"name": name, "materials": made, "bodies": entries}
    with compiled.refusals.collecting():
        creature = make_section(CreatureConfig, whole, f"model {name!r}")
        return Imported(creature, _left_out(compiled, fluid))
    compiled.refusals.check()
    raise AssertionError("unreachable")


def _read_shapes(
    compiled: Compiled, bodies: list[int]
) -> tuple[dict[int, Placed], dict[int, MaterialConfig]]:
    """Return shapes and materials of the bodies, except refused ones."""
    placed: dict[int, Placed] = {}
    made_of: dict[int, MaterialConfig] = {}
    for body in bodies:
        with compiled.refusals.collecting():
            geom = only_geom(compiled, body)
            placed[body] = own = place_body(compiled, body, geom, body == bodies[0])
            density = uniform_density(compiled, body, geom, own)
            made_of[body] = _material(compiled, geom, density)
    return placed, made_of


def _find_root(compiled: Compiled) -> int:
    """Return the body at the top of the tree."""
    model = compiled.model
    tops = [i for i in range(1, model.nbody) if model.body_parentid[i] == WORLD]
    if not tops:
        raise ExchangeError(f"{compiled.source}: the worldbody holds no body. Allowed: one")
    root = tops[0]
    for other in tops[1:]:
        problem = f"it is in the worldbody together with {compiled.item('body', root)}"
        compiled.item("body", other).refuse(problem, "one body there, the root")
    joints = joints_of(model, root)
    free = compiled.mujoco.mjtJoint.mjJNT_FREE
    if [int(model.jnt_type[joint]) for joint in joints] != [free]:
        compiled.item("body", root).refuse("the root does not float freely", "a freejoint")
        return root
    dofs = slice(int(model.jnt_dofadr[joints[0]]), int(model.jnt_dofadr[joints[0]]) + 6)
    for field, word in _OF_ROOT.items():
        places = dofs if field.startswith("dof") else joints[0]
        if np.any(getattr(model, field)[places]):
            compiled.item("joint", joints[0]).refuse(f"it has {word}", f"no {word}")
    return root


def _body_names(compiled: Compiled) -> dict[int, str]:
    mujoco, model = compiled.mujoco, compiled.model
    given = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, i) for i in range(model.nbody)]
    names = {}
    for i, name in enumerate(given):
        if name and "{i}" in name:
            problem = "its name contains {i}, which stands for a number in our names"
            compiled.item("body", i).refuse(problem, "a name without {i}")
        invented = f"body{i}"
        while invented in given:
            invented += "_"
        names[i] = name or invented
    return names


def _material(compiled: Compiled, geom: int, density: float) -> MaterialConfig:
    friction = tidy(compiled.model.geom_friction[geom, 0])
    values = {
        "density": tidy(density),
        "static_friction": friction,
        "dynamic_friction": friction,
    }
    return compiled.item("geom", geom).section(MaterialConfig, values)


def _left_out(compiled: Compiled, fluid: float) -> tuple[str, ...]:
    """Name parts that belong to the world, or do not affect the motion.

    Args:
        compiled: the model.
        fluid: density of the fluid whose buoyancy carries the bodies, kg/m^3.
    """
    model = compiled.model
    options = left_out_options(compiled)
    found = []
    if _has_weight(compiled):
        gravity = ", ".join(f"{value:g}" for value in model.opt.gravity)
        found.append(f"gravity ({gravity}) m/s^2")
    ground = [i for i in range(model.ngeom) if model.geom_bodyid[i] == WORLD]
    found += [str(compiled.item("geom", geom)) for geom in ground]
    if fluid:
        found.append(f"the buoyancy of a fluid of {fluid:g} kg/m^3")
    medium = [name for name in ("density", "viscosity") if name in options]
    if medium:
        found.append(f"drag of the fluid (option {', '.join(medium)})")
    found += [f"option {name}" for name in options if name not in ("gravity", *medium)]
    found += _collisions(compiled)
    ranges = command_ranges(compiled)
    if len(ranges) == 1:
        found.append(f"the ctrlrange of {compiled.item('actuator', ranges[0])}")
    elif ranges:
        found.append(f"the ctrlrange of {len(ranges)} actuators")
    return (*found, *left_out_counts(compiled))


def _collisions(compiled: Compiled) -> list[str]:
    """Name settings of contacts, which `self_collision` replaces in a creature."""
    model = compiled.model
    own = model.geom_bodyid != WORLD
    bits = np.stack([model.geom_contype, model.geom_conaffinity], 1)
    # Contact bits of MuJoCo's default, and of our own export.
    usual = (bits == [1, 1]).all(1) | (bits == [0, 1]).all(1)
    unusual = int((own & ~usual).sum())
    # A pair with the ground belongs to the ground. `self_collision` gives pairs without friction.
    among = own[model.pair_geom1] & own[model.pair_geom2]
    plain = model.pair_dim == 1
    for field, value in PLAIN_PAIR.items():
        close = np.isclose(getattr(model, field, value), value)
        plain &= close.all(axis=tuple(range(1, close.ndim)))
    pairs = (among & ~plain).sum()
    found = [f"contype and conaffinity of {unusual} geom{'s' * (unusual > 1)}"] if unusual else []
    found += counted(int(pairs), "contact pair") + counted(int(model.nexclude), "contact exclude")
    return found + [f"flag {flag}" for flag in _OF_COLLISIONS if compiled.disabled(flag)]


def _has_weight(compiled: Compiled) -> bool:
    return bool(np.any(compiled.model.opt.gravity)) and not compiled.disabled("gravity")


def _buoyancy(compiled: Compiled, placed: dict[int, Placed]) -> float:
    """Return the density of the fluid that carries all bodies, kg/m^3, or 0."""
    if not _has_weight(compiled):
        return 0.0
    model = compiled.model
    bodies = list(placed)
    volumes = [placed[body].shape.build().volume for body in bodies]
    fluid = model.body_gravcomp[bodies] * model.body_mass[bodies] / volumes
    alike = np.isclose(fluid, fluid[0], rtol=TOLERANCE, atol=0)
    wrong = np.flatnonzero(~alike | (fluid < 0))
    if wrong.size:
        raise compiled.item("body", bodies[int(wrong[0])]).refusal(
            "its gravcomp is not the buoyancy of a fluid around all bodies",
            "gravcomp in inverse proportion to the density, or none",
        )
    return tidy(fluid[0])


def _color(model: Any, geom: int) -> str | None:
    rgba = model.geom_rgba[geom]
    if np.allclose(rgba, _GREY):
        return None
    return "#" + "".join(f"{round(255 * float(value)):02x}" for value in np.clip(rgba[:3], 0, 1))


def _model_name(compiled: Compiled) -> str:
    name = bytes(compiled.model.names).split(b"\0", 1)[0].decode()
    return compiled.source.stem if name in ("", "MuJoCo Model") else name
