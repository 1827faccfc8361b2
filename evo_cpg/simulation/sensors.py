"""Sensors: light, pressure, attitude (Iwadate 2010, eq. 1 and Table 2), depth, and others.

Eyes, pressure sensors and depth gauges are built in, and `Sensors` has their places. Any further
kind of sensor is a subclass of `Sensor`. The config names the class in ``creature.sensors``, as a
built-in kind or as ``my_module:MySensor``. Its readings go into `Observation.custom`.
"""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import as_matrix_of, dot, expand_dims_like, matvec, matvec_t
from evo_cpg.creature.algebra.numerics import MixedArray, Number, Numbers, xp
from evo_cpg.creature.creature import Creature, DepthSensor, LightSensor
from evo_cpg.creature.per_body import take
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.simulation.snapshot import Forces, Snapshot

# Added under square roots, so that a light at the sensor's own place gives a finite gradient.
_DISTANCE_FLOOR = 1e-12


class Sensors(NamedTuple):
    """Places of the sensors on the tree.

    Attributes:
        eye_bodies: index of the body that carries each light sensor.
        eye_positions: ``(3, eyes)`` positions in the body's working frame, m.
        eye_axes: ``(3, eyes)`` unit vectors of the lines of sight, in the body's working frame.
        fields_of_view: ``(eyes,)`` full opening angles, rad.
        pressure_bodies: index of the body behind each pressure sensor.
        depth_bodies: index of the body that carries each depth gauge.
        depth_positions: ``(3, gauges)`` positions in the body's working frame, m.
        depth_scales: ``(gauges,)`` depths at which the reading is 1, m.
        blind: True to let every eye read 0.
    """

    eye_bodies: tuple[int, ...]
    eye_positions: np.ndarray
    eye_axes: np.ndarray
    fields_of_view: np.ndarray
    pressure_bodies: tuple[int, ...]
    depth_bodies: tuple[int, ...]
    depth_positions: np.ndarray
    depth_scales: np.ndarray
    blind: bool = False


def place_sensors(creature: Creature, tree: Tree) -> Sensors:
    """Return the bodies and positions of the creature's sensors on its tree."""
    eyes, gauges = creature.light_sensors, creature.depth_sensors

    def place(
        carried: tuple[LightSensor, ...] | tuple[DepthSensor, ...],
    ) -> tuple[tuple[int, ...], Numbers]:
        bodies = tuple(tree.names.index(sensor.body) for sensor in carried)
        positions = xp.array([sensor.position for sensor in carried], float).reshape(-1, 3).T
        return bodies, positions + tree.centre[:, np.array(bodies, int)]

    eye_bodies, eye_positions = place(eyes)
    depth_bodies, depth_positions = place(gauges)
    return Sensors(
        eye_bodies,
        eye_positions,
        xp.array([eye.axis for eye in eyes], float).reshape(-1, 3).T,
        xp.array([eye.field_of_view for eye in eyes], float),
        tuple(tree.names.index(name) for name in creature.pressure_sensors),
        depth_bodies,
        depth_positions,
        xp.array([gauge.full_scale for gauge in gauges], float),
    )


def pressure_readings(
    sensors: Sensors, world: World, kin: Kinematics, force: Float[Array, "3 p *n"] | None
) -> Float[Array, "s *n"]:
    """Return the pressure readings: 1 where the ground presses harder than the water, else 0.

    The paper (section 2.1) compares the outer pressure with the water's. Here the ground's pressure
    is its normal force on the body divided by the body's mean cross-section, ``volume^(2/3)``. The
    water's pressure is hydrostatic, at the depth of the body's centre. It is 0 on land, and in
    water without a surface.

    Args:
        sensors: places of the sensors.
        world: the animal and its environment.
        kin: present pose of the animal.
        force: force of the ground on every contact point, contact frame, N, or None without
            ground.
    """
    bodies = np.array(sensors.pressure_bodies, int)
    if force is None or world.contact_model is None or not len(bodies):
        return jnp.zeros((len(bodies), *kin.origin.shape[2:]), kin.origin.dtype)
    # A further part counts as its body.
    owners = np.array(world.tree.wholes)[np.array(world.contact_model.bodies)]
    normal = jnp.stack([take(force[2], np.flatnonzero(owners == i), 0).sum(0) for i in bodies])
    pressing = jnp.zeros_like(normal)
    if world.water is not None and world.water.surface is not None:
        depth = _depth(world.water.surface, kin, bodies, world.tree.centre[:, bodies])
        # The volume of a body includes its further parts.
        volume, wholes = world.tree.volume, np.array(world.tree.wholes)
        if (wholes != np.arange(len(wholes))).any():
            volume = xp.array([volume[np.flatnonzero(wholes == i)].sum() for i in bodies])
        else:
            volume = volume[bodies]
        area = expand_dims_like(volume ** (2 / 3), depth)
        pressing = world.water.density * world.gravity * jnp.maximum(depth, 0.0) * area
    return (normal > pressing).astype(normal.dtype)


def body_loads(world: World, force: Float[Array, "3 p *n"]) -> Float[Array, "b *n"]:
    """Return the upward force of the ground on each body, as a fraction of the animal's weight.

    Loads are 0 without ground or without gravity. They are not negative.

    Args:
        world: the animal and its environment.
        force: force of the ground on every contact point, world axes, N.
    """
    count, none = len(world.tree.names), jnp.zeros_like(force[0, :0].sum(0))
    if world.contact_model is None:
        return jnp.stack([none] * count)
    # A further part counts as its body.
    owners = np.array(world.tree.wholes)[np.array(world.contact_model.bodies)]
    upward = [np.flatnonzero(owners == body) for body in range(count)]
    weight = jnp.asarray(world.weight, force.dtype)
    of_bodies = [take(force[2], own, 0).sum(0) if len(own) else none for own in upward]
    heavy = weight > 0
    return jnp.where(heavy, jnp.maximum(jnp.stack(of_bodies), 0.0), 0.0) / jnp.where(
        heavy, weight, 1.0
    )


def depth_readings(sensors: Sensors, world: World, kin: Kinematics) -> Float[Array, "k *n"]:
    """Return the depth readings: 0 at the surface and above, 1 from full scale down.

    This is the hydrostatic pressure relative to the pressure at full scale. The readings are 0 on
    land, and in water without a surface.
    """
    bodies = np.array(sensors.depth_bodies, int)
    if not len(bodies) or world.water is None or world.water.surface is None:
        return jnp.zeros((len(bodies), *kin.origin.shape[2:]), kin.origin.dtype)
    depth = _depth(world.water.surface, kin, bodies, sensors.depth_positions)
    return jnp.clip(depth / expand_dims_like(sensors.depth_scales, depth), 0.0, 1.0)


def _depth(
    surface: ArrayLike, kin: Kinematics, bodies: np.ndarray, places: np.ndarray | Array | MixedArray
) -> Float[Array, "k *n"]:
    """Return the depth of points of bodies below the water's surface, m, negative above it."""
    own = take(kin.origin[2], bodies, 0)
    lever = take(kin.rotation[2], bodies) * as_matrix_of(places, own)
    return jnp.asarray(surface - own - lever.sum(0))


def light_strength(
    angle_cosine: Float[Array, "eyes *n"], field_of_view: Float[Array, "eyes *#n"]
) -> Float[Array, "eyes *n"]:
    """Return the light seen, ``cos(pi theta / R)`` within half the field of view R, else 0 (eq. 1).

    Differs from the printed condition ``theta <= R``, which gives values down to -1, although Table
    2 requires [0, 1].
    """
    angle = jnp.arccos(jnp.clip(angle_cosine, -1 + 1e-7, 1 - 1e-7))
    return jnp.maximum(jnp.cos(jnp.pi * jnp.minimum(angle / field_of_view, 0.5)), 0.0)


def light_readings(
    sensors: Sensors, kin: Kinematics, light: Float[Array, "3 *#n"] | None
) -> tuple[Float[Array, "eyes *n"], Float[Array, "eyes *n"], Float[Array, "eyes *n"]]:
    """Return light strength, and cosine and sine of the eyes' angle to the vertical.

    No eye sees light if the place of the light (m) is None.
    """
    bodies = list(sensors.eye_bodies)
    if not bodies:
        none = jnp.zeros((0, *kin.origin.shape[2:]), kin.origin.dtype)
        return none, none, none
    rotation = jnp.stack([kin.rotation[:, :, i] for i in bodies], 2)
    origin = jnp.stack([kin.origin[:, i] for i in bodies], 1)
    axis = matvec(rotation, expand_dims_like(sensors.eye_axes, origin))
    cosine = axis[2]
    sine = jnp.sqrt(jnp.maximum(1.0 - cosine * cosine, 0.0) + _DISTANCE_FLOOR)
    if light is None or sensors.blind:
        return jnp.zeros_like(cosine), cosine, sine
    to_light = (
        light[:, None] - origin - matvec(rotation, expand_dims_like(sensors.eye_positions, origin))
    )
    distance = jnp.sqrt(dot(to_light, to_light) + _DISTANCE_FLOOR)
    strength = light_strength(
        dot(axis, to_light) / distance, expand_dims_like(sensors.fields_of_view, distance)
    )
    return strength, cosine, sine


def bearings(snapshot: Snapshot) -> Float[Array, "3 b *n"]:
    """Return the direction from the centre of each body to the light, in the body's own axes.

    They are 0 in the dark.
    """
    position = snapshot.position
    if snapshot.light_position is None:
        return jnp.zeros_like(position)
    away = snapshot.light_position[:, None] - position
    distance = jnp.sqrt(dot(away, away) + _DISTANCE_FLOOR)
    return matvec_t(snapshot.rotation, away / distance[None])


class Sensor(eqx.Module):
    """Readings that the animal senses at the start of every control step.

    Subclass it to write your own sensor: declare the number of readings, and compute them in
    `sense`. The sensor is built with the keyword arguments in the config's ``options``. It also
    gets ``tree`` and ``control_step`` (s) if its constructor takes them. Readings from -1 to 1 suit
    a neural network best.

    Attributes:
        count: number of readings.
        uses_acceleration: whether it needs `Forces.acceleration` (False unless overridden).

    Example:
        Vertical speed of the animal::

            class Variometer(Sensor):
                count: int = eqx.field(static=True, default=1)
                full_scale: float = 1.0

                def sense(self, snapshot, forces):
                    return snapshot.state.linear_velocity[2:] / self.full_scale
    """

    count: eqx.AbstractVar[int]

    uses_acceleration = False

    @abc.abstractmethod
    def sense(self, snapshot: Snapshot, forces: Forces) -> Float[Array, "count *n"]:
        """Return the readings.

        Must be a pure JAX function of arrays whose trailing axes are individuals.

        Args:
            snapshot: the animal at this instant.
            forces: forces of motors and ground in the last control step, zero at the start.
        """


class VelocitySensor(Sensor):
    """Velocity of the centre of a body's shape in the world, along the body's own x, y and z axes.

    Attributes:
        body: name of the body that carries the sensor.
        full_scale: velocity at which the reading is 1, m/s. Readings are clipped to -1 and 1.
        count: 3.
    """

    body: str = eqx.field(static=True)
    full_scale: Number = 1.0
    count: int = eqx.field(static=True, default=3, init=False)

    def sense(self, snapshot: Snapshot, forces: Forces) -> Float[Array, "3 *n"]:
        """See `Sensor.sense`."""
        del forces
        i = snapshot.body(self.body)
        own = matvec_t(snapshot.rotation[:, :, i], snapshot.velocity[:, i])
        return jnp.clip(own / self.full_scale, -1.0, 1.0)


class LoadSensor(Sensor):
    """Upward force of the ground on a body, as a fraction of the animal's weight.

    It is the mean over the last control step, 0 before the first one.

    Attributes:
        body: name of the body that carries the sensor, such as a foot.
        full_scale: fraction at which the reading is 1. Readings are clipped to 0 and 1.
        count: 1.
    """

    body: str = eqx.field(static=True)
    full_scale: Number = 1.0
    count: int = eqx.field(static=True, default=1, init=False)

    def sense(self, snapshot: Snapshot, forces: Forces) -> Float[Array, "1 *n"]:
        """See `Sensor.sense`."""
        load = body_loads(snapshot.world, forces.contact_force)[snapshot.body(self.body)]
        return jnp.clip(load / self.full_scale, 0.0, 1.0)[None]
