"""Specks that flowing water carries, with short tails along their paths.

A frame must not depend on the frames before it, because several processes draw. Each speck
therefore lives for a few seconds, and its path is integrated anew from its birth in every frame.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pyvista as pv
from jaxtyping import Array, Float

from evo_cpg.physics.water.water import Water
from evo_cpg.view.offscreen import add_faded
from evo_cpg.view.stage import Shot, Stage, Update

# Number of specks, the half extents of the box around the focus in which they are born, in radii of
# the animal, and the seed of their places.
_SPECKS, _BOX, _SEED = 1400, np.array([2.7, 2.7, 0.9]), 20108
# Length of a tail in fast water in radii, and its longest duration, s. Fraction of the water that
# is slower. Life of a speck in durations of a tail.
_TAIL, _LONGEST, _FAST, _LIFE = 0.25, 1.0, 0.95, 6.0
# Steps of the Runge-Kutta method from birth to the end of the tail, and along the tail.
_EARLY, _LATE = 20, 12
# Each life begins at another place: fractions of a low-discrepancy sequence (Roberts 2018).
_NEXT = np.array([0.8191725134, 0.6710436067, 0.5497004779])
# Part of a life in which a speck appears, and disappears. Widths of a tail and of a dot, pixels.
# Opacity of a speck at rest, and colour of all.
_FADE, _WIDTH, _DOT, _RESTING, _SPECK = 0.2, 1.5, 2.0, 0.35, "#d9fff6"


def add_flow(stage: Stage, water: Water) -> Update:
    """Draw specks that flowing water carries around the animal."""
    rng, box = np.random.default_rng(_SEED), _BOX * stage.radius
    first, offset = rng.random((_SPECKS, 3)), rng.random(_SPECKS)
    tail = _tail_of(stage, water, box)
    life, carry = _LIFE * tail, jax.jit(functools.partial(carried, water))
    lines = np.arange(_SPECKS * (_LATE + 1)).reshape(_SPECKS, -1)
    # A speck that rests has no tail, but a dot.
    heads, tails = np.insert(lines[:, -1:], 0, 1, 1), np.insert(lines, 0, _LATE + 1, 1)
    mesh = pv.PolyData(np.zeros((lines.size, 3)), verts=heads.ravel(), lines=tails.ravel())
    rgba = np.zeros((lines.size, 4), np.uint8)
    rgba[:, :3] = pv.Color(_SPECK).int_rgb
    wide = {"line_width": _WIDTH * stage.oversampling, "point_size": _DOT * stage.oversampling}
    add_faded(stage.plotter, mesh, rgba, **wide)
    growing = np.linspace(0.0, 1.0, _LATE + 1) ** 1.5

    def update(shot: Shot) -> None:
        number, age = np.divmod(shot.time / life + offset, 1.0)
        place = 2 * box * ((first + number[:, None] * _NEXT) % 1.0)
        # The copy of the box that surrounds the focus.
        place += 2 * box * np.round((shot.focus - place) / (2 * box))
        times = shot.time - life * age, shot.time - np.minimum(tail, life * age)
        path = np.asarray(carry(place.T, *times, shot.time)).transpose(2, 0, 1)
        mesh.points = path.reshape(-1, 3)
        off = np.abs((place - shot.focus) / box)
        near = np.clip(3 * (1 - off), 0.0, 1.0).prod(1)
        fresh = np.clip(np.minimum(age, 1 - age) / _FADE, 0.0, 1.0)
        head = path[:, -1]
        wet = head[:, 2] > stage.ground.height(head[:, :2])
        if water.surface is not None:
            wet &= head[:, 2] < water.surface
        moved = np.linalg.norm(head - path[:, 0], axis=1) / (_TAIL * stage.radius)
        bright = np.interp(moved, (0.0, 1.0), (_RESTING, 1.0)) * near * fresh * wet
        rgba[:, 3] = (255 * bright[:, None] * growing).ravel()
        mesh["rgba"] = rgba

    return update


def _tail_of(stage: Stage, water: Water, box: Float[np.ndarray, "3"]) -> float:
    """Return the duration of a tail, s, from the speed near the path of the camera."""
    rng, count = np.random.default_rng(_SEED), 1000
    frames = rng.integers(len(stage.camera.focus), size=count)
    place = stage.camera.focus[frames] + 0.5 * box * rng.uniform(-1, 1, (count, 3))
    flow = np.asarray(water.along(jnp.asarray(place.T), jnp.asarray(stage.scene.clip.time[frames])))
    speed = float(np.quantile(np.linalg.norm(flow, axis=0), _FAST))
    return min(_TAIL * stage.radius / max(speed, 1e-9), _LONGEST)


def carried(
    water: Water,
    place: Float[Array, "3 n"],
    born: Float[Array, " n"],
    end: Float[Array, " n"],
    now: Float[Array, ""],
) -> Float[Array, "late 3 n"]:
    """Return the last part of the paths of points that the water carries, m.

    Args:
        water: the water.
        place: places of birth, m.
        born: times of birth, s.
        end: times at which the returned parts begin, s.
        now: time at which they end, s.
    """

    def velocity(place: Array, time: Array) -> Array:
        return water.at(time).velocity(place[:, None])[:, 0]

    def follow(place: Array, start: Array, end: Array, count: int) -> Array:
        step = (end - start) / count

        def advance(place: Array, time: Array) -> tuple[Array, Array]:
            a = velocity(place, time)
            b = velocity(place + 0.5 * step * a, time + 0.5 * step)
            c = velocity(place + 0.5 * step * b, time + 0.5 * step)
            d = velocity(place + step * c, time + step)
            place = place + step / 6 * (a + 2 * b + 2 * c + d)
            return place, place

        _, path = jax.lax.scan(advance, place, start + step * np.arange(count))
        return path

    def alone(place: Array, born: Array, end: Array) -> Array:
        early = follow(place, born, end, _EARLY)[-1]
        return jnp.concatenate([early[None], follow(early, end, now, _LATE)])

    return jax.vmap(alone, -1, -1)(place, born, end)
