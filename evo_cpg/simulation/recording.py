"""Motion of one individual, for films, plots and exports."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.algebra.linear import cross, expand_dims_like
from evo_cpg.creature.axis_kinds import kind_named
from evo_cpg.errors import UserError
from evo_cpg.native.fuse import fuse
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.simulation.control_step import Effects
from evo_cpg.simulation.observers import Observer, Seen
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.snapshot import Snapshot

# Prefixes of the names of recorded arrays with readings of sensors and with the controller's state.
SENSE, NERVE = "sense.", "nerve."
# A light jumps if it moves so many times farther than in a mean step, and than in the steps around.
_JUMP, _ALONE = 20.0, 4.0


class RecordingError(UserError, ValueError):
    """Raised for a recording that is incomplete, not finite, or shows another creature."""


class Recording(NamedTuple):
    """Motion of one animal in one trial, sampled once per control step.

    Bodies are in the order of ``creature.bodies``, degrees of freedom in the order of
    ``dof_names``.

    Attributes:
        time: time since the start of the trial, s.
        position: centre of every body in the world, m.
        rotation: rotation of every body, from body to world axes.
        joint_angle: joint angles, rad, and displacements of slides, m.
        target_rate: commanded rate of each motor, rad/s.
        cpg_output: output of each oscillator, or `Command.signal` of a controller without
            oscillators.
        torque: torque of each motor, N m.
        distance: distance from the root to the light, m. If there is no light, horizontal distance
            from the root's initial place.
        light: place of the light in the world, m, or NaN without a light.
        dof_names: name of each degree of freedom, ``body.axis``.
    """

    time: Float[np.ndarray, " t"]
    position: Float[np.ndarray, "t b 3"]
    rotation: Float[np.ndarray, "t b 3 3"]
    joint_angle: Float[np.ndarray, "t d"]
    target_rate: Float[np.ndarray, "t d"]
    cpg_output: Float[np.ndarray, "t d"]
    torque: Float[np.ndarray, "t d"]
    distance: Float[np.ndarray, " t"]
    light: Float[np.ndarray, "t 3"]
    dof_names: tuple[str, ...]

    @property
    def goal(self) -> Float[np.ndarray, "3"]:
        """Place of the light at the start, m, or NaN without a light."""
        return self.light[0]

    @property
    def moves_light(self) -> bool:
        """Whether the light moves, or other lights appear."""
        return bool(np.abs(self.light - self.goal).max() > 0)

    @property
    def appearances(self) -> Int[np.ndarray, " k"]:
        """Numbers of the instants at which a light appears in a new place (`appearances`)."""
        return appearances(self.light)

    @property
    def slides(self) -> Bool[np.ndarray, " d"]:
        """Degrees of freedom whose coordinate is a length, with the units m, m/s and N."""
        return np.array([kind_named(name).unit == "m" for name in self.dof_names], bool)

    def __repr__(self) -> str:
        span = f" from {self.time[0]:.4g} to {self.time[-1]:.4g} s" if len(self.time) else ""
        return (
            f"Recording({len(self.time)} instants{span}, {self.position.shape[1]} bodies, "
            f"{len(self.dof_names)} joint axes)"
        )


@dataclasses.dataclass(frozen=True)
class Recorder(Observer):
    """Keeps arrays of every control step by name, for `as_recording`.

    Attributes:
        count: number of individuals that are recorded, or None for all.
        first: index of the first of them.
        full: True to add velocities, senses and the state of the controller.
        names: names of the arrays that are kept, or None for all.
        every: number of control steps between two that are kept.
    """

    every_step = True
    count: int | None = 1
    first: int = 0
    full: bool = False
    names: tuple[str, ...] | None = None
    every: int = 1

    def of_step(self, seen: Seen) -> dict[str, Array]:
        """Return the recorded arrays of a control step, by name."""
        frame = functools.partial(_frame, seen.simulation, self.full)
        frames = fuse(frame, seen.effects, batch_ndim=seen.effects.energy.ndim)
        if self.full:
            # Arrays in the controller's state have names such as ``nerve.potential``.
            leaves, _ = jax.tree_util.tree_flatten_with_path(seen.animal.nerves)
            frames |= {NERVE + jax.tree_util.keystr(path).strip("."): x for path, x in leaves}
        frames = {name: frames[name] for name in self.names or frames}
        # Different bodies are simulated one by one, and chosen afterwards.
        return self.of_bodies(frames) if seen.effects.energy.ndim else frames

    def of_bodies(self, result: dict[str, Array]) -> dict[str, Array]:
        """Return the arrays of the recorded individuals."""
        if self.count is None:
            return result
        chosen = slice(self.first, self.first + self.count)
        return {name: values[..., chosen] for name, values in result.items()}

    def finish(
        self, simulation: Simulation, tally: tuple, steps: dict[str, Array]
    ) -> dict[str, Array]:
        """Return the arrays with time on the first axis."""
        del simulation, tally
        return {name: values[:: self.every] for name, values in steps.items()}


def as_recording(
    simulation: Simulation,
    frames: Mapping[str, Array | np.ndarray],
    names: list[str],
    individual: int = 0,
    trial: int = 0,
) -> Recording:
    """Return the recording of one individual, with the bodies in the creature's order.

    Args:
        simulation: the trial.
        frames: arrays from `Recorder`.
        names: names of the bodies in the order of ``creature.bodies``.
        individual: index among the recorded individuals.
        trial: number of the situation.
    """
    tree = simulation.world.tree
    order = [tree.names.index(name) for name in names]
    arrays = {name: np.asarray(values[..., individual]) for name, values in frames.items()}
    position = np.moveaxis(arrays["position"], -1, 1)
    root = position[:, 0]
    light = light_of(simulation, arrays, trial)
    path = root - light if np.isfinite(light).all() else (root - root[0])[:, :2]
    return Recording(
        time=np.arange(simulation.steps) / simulation.control_rate,
        position=position[:, order],
        rotation=np.moveaxis(arrays["rotation"], -1, 1)[:, order],
        joint_angle=arrays["joint_angle"],
        target_rate=arrays["target_rate"],
        cpg_output=arrays["cpg_output"],
        torque=arrays["torque"],
        distance=np.linalg.norm(path, axis=-1),
        light=light,
        dof_names=tree.dof_names,
    )


def light_of(
    simulation: Simulation, arrays: Mapping[str, np.ndarray], trial: int
) -> Float[np.ndarray, "t 3"]:
    """Return the place of the light at the instants of one individual's arrays, m, or NaN."""
    if "light" in arrays:
        return arrays["light"].astype(float)
    light = simulation.lights[trial if len(simulation.situations) > 1 else 0]
    return np.tile(np.full(3, np.nan) if light is None else light, (len(arrays["position"]), 1))


def appearances(light: Float[np.ndarray, "t 3"]) -> Int[np.ndarray, " k"]:
    """Return the instants at which a light appears: the first one, and those at which it jumps.

    A light that glides appears once. Without a light there are none.
    """
    moved = np.linalg.norm(np.diff(light, axis=0), axis=-1)
    around = np.maximum(np.append(moved[1:], 0.0), np.append(0.0, moved[:-1]))[: len(moved)]
    jumps = (moved > _JUMP * moved.sum() / max(len(moved), 1)) & (moved > _ALONE * around)
    return np.flatnonzero(np.append(np.isfinite(light[0]).all(), jumps))


def _frame(simulation: Simulation, full: bool, effects: Effects) -> dict[str, Array]:
    """Return the recorded arrays of one control step by name, without the controller's state."""
    world = simulation.world
    tree = world.tree
    kin = kinematics(tree, effects.before)
    centre = expand_dims_like(tree.centre, kin.origin)
    residual = {} if effects.residual is None else effects.residual._asdict()
    lever = (kin.rotation * centre[None]).sum(1)
    frame = {
        "position": kin.origin + lever,
        "rotation": kin.rotation,
        "joint_angle": effects.before.q,
        "target_rate": effects.command.target_rate,
        "cpg_output": effects.command.signal,
        "torque": effects.forces.torque,
        "contact_force": effects.forces.contact_force,
        "pair_force": effects.forces.pair_force,
        "energy": effects.energy,
        **{f"{name}_residual": values for name, values in residual.items()},
    }
    if world.contact_model is not None:
        after = Snapshot(world, 1.0 / simulation.control_rate, effects.after)
        frame["contact_velocity"] = after.contact_velocity
    if effects.forces.holding is not None:
        frame["holding"] = effects.forces.holding
    if effects.light is not None:
        frame["light"] = effects.light
    if effects.command.activation is not None:
        frame["activation"] = effects.command.activation
    if effects.command.torque is not None:
        frame["commanded_torque"] = effects.command.torque
    if full:
        # Joint angles and rates are recorded with the state.
        senses = effects.observation._replace(joint_angle=None, joint_rate=None)._asdict()
        frame |= {
            "velocity": kin.linear + cross(kin.angular, lever),
            "angular_velocity": kin.angular,
            "joint_rate": effects.before.qd,
            **{SENSE + name: values for name, values in senses.items() if values is not None},
        }
    return frame
