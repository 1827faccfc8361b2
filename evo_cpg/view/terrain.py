"""Ground for drawing: level, or a mesh of its heights, with obstacles drawn as stone.

The mesh is a grid. Its lines are close together along the animal's path and ever further apart
towards the horizon. Lines run along the creases of the ground, if it has any.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import pyvista as pv
from jaxtyping import Array, Float

from evo_cpg.physics.contact.terrain import Block, Boulder, GroundPart, Plane, Relief, Shore
from evo_cpg.view.offscreen import grid_triangles, placed

# Distance between the grid's lines near the path, and the margin with this distance, in radii of
# the animal. Most lines with this distance, and growth of the distance further out. A frame of 960
# x 540 with 100,000 crossings took 126 ms on one core of a software renderer.
_STEP, _NEAR, _LINES, _GROWTH = 0.08, 5.0, 100, 1.18

# Places per call. A mesh has tens of thousands, the camera's path some hundreds, and every new
# number of places would compile another program.
_BLOCK = 4096


class Level(NamedTuple):
    """Level ground.

    Attributes:
        z: height of the ground, m.
    """

    z: float

    def height(self, place: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Return the height at places x and y, m."""
        return np.full(place.shape[:-1], self.z)


class Terrain(NamedTuple):
    """Heights at the crossings of grid lines, with two triangles in each cell.

    Attributes:
        x: coordinates of the lines across x, ascending, m.
        y: coordinates of the lines across y, ascending, m.
        z: heights of the crossings, m.
    """

    x: Float[np.ndarray, " nx"]
    y: Float[np.ndarray, " ny"]
    z: Float[np.ndarray, "nx ny"]

    def points(self) -> Float[np.ndarray, "n 3"]:
        """Return the crossings, m. The last axis of the grid varies fastest."""
        x, y = np.meshgrid(self.x, self.y, indexing="ij")
        return np.stack([x, y, self.z], -1).reshape(-1, 3)

    def normals(self) -> Float[np.ndarray, "n 3"]:
        """Return unit vectors out of the ground at the crossings."""
        along_x, along_y = np.gradient(self.z, self.x, self.y)
        normal = np.stack([-along_x, -along_y, np.ones_like(self.z)], -1).reshape(-1, 3)
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)

    def triangles(self) -> np.ndarray:
        """Return the triangles as indices of their corners among the crossings ``(m, 3)``."""
        return grid_triangles(np.arange(self.z.size).reshape(self.z.shape))

    def height(self, place: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Return the height of the mesh, m. Places beyond the mesh have the height of its edge.

        Args:
            place: coordinates x and y, m.
        """
        # Index of the cell between lines, and the fraction within the cell, along either axis.
        found = []
        for axis, lines in enumerate((self.x, self.y)):
            inside = np.clip(place[..., axis], lines[0], lines[-1])
            cell = np.clip(np.searchsorted(lines, inside, "right") - 1, 0, len(lines) - 2)
            found.append((cell, (inside - lines[cell]) / (lines[cell + 1] - lines[cell])))
        (i, u), (j, v) = found
        a, c = self.z[i, j], self.z[i + 1, j + 1]
        corner = np.where(u > v, self.z[i + 1, j], self.z[i, j + 1])
        less, more = np.minimum(u, v), np.maximum(u, v)
        return a + (more - less) * (corner - a) + less * (c - a)


def heights(floor: GroundPart, place: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    """Return the height of the ground above the world's origin, m, at places x and y, m.

    The surface lies ``gap / n_z`` straight below a point at z = 0. This is exact for planes, and
    follows from the definition of the distance for z = H(x, y).

    Raises:
        TypeError: ground of this kind has no heights.
    """
    if not isinstance(floor, Plane | Shore | Relief):
        raise TypeError(
            f"a floor of type {type(floor).__name__} has no heights. Allowed: Plane, Shore, Relief"
        )
    flat = np.asarray(place, float).reshape(-1, 2)
    filled = np.zeros((3, -(-len(flat) // _BLOCK) * _BLOCK), np.float32)
    filled[:2, : len(flat)] = flat.T
    blocks = np.split(filled, filled.shape[1] // _BLOCK, axis=1)
    high = np.concatenate([np.asarray(_heights(floor, block), float) for block in blocks])
    return high[: len(flat)].reshape(place.shape[:-1])


def make_terrain(
    floor: GroundPart, path: Float[np.ndarray, "n 2"], radius: float, far: float
) -> Terrain:
    """Mesh the ground around a path.

    Args:
        floor: floor of the ground.
        path: coordinates x and y of the filmed points, m.
        radius: radius of the animal, m.
        far: distance by which the mesh reaches beyond the path, m.
    """
    low, high = path.min(0) - _NEAR * radius, path.max(0) + _NEAR * radius
    step = max(_STEP * radius, float((high - low).max()) / _LINES)
    found = []
    for i, axis in enumerate("xy"):
        # Coordinates where the slope of the ground jumps.
        creases = np.zeros(0)
        if isinstance(floor, Shore) and floor.axis == axis:
            creases = np.array([floor.start, floor.stop], float)
        elif isinstance(floor, Relief):
            creases = floor.corner[i] + floor.spacing * np.arange(floor.heights.shape[i])
        near = np.linspace(low[i], high[i], int(np.ceil((high[i] - low[i]) / step)) + 1)
        count = int(np.ceil(np.log1p(far * (_GROWTH - 1) / step) / np.log(_GROWTH)))
        beyond = step * (_GROWTH ** np.arange(1, count + 1) - 1) / (_GROWTH - 1)
        even = np.concatenate([low[i] - beyond[::-1], near, high[i] + beyond])
        # A crease replaces an even line, unless creases are finer than the lines. Heights are then
        # exact only at the lines.
        width = np.gradient(even)
        inside = creases[(creases > even[0]) & (creases < even[-1])]
        room = np.interp(inside, even, width)
        if len(inside) > 1 and np.diff(inside).min() < 0.7 * step:
            inside = inside[:0]
        elif len(inside) > 2:
            # Keep the creases of a relief only where the mesh's lines are about as close.
            inside = inside[room <= 1.5 * np.diff(inside).min()]
        if len(inside):
            clear = np.abs(even[:, None] - inside).min(1) > 0.35 * width
            even = np.sort(np.concatenate([even[clear], inside]))
        found.append(even)
    x, y = found
    return Terrain(x, y, heights(floor, np.stack(np.meshgrid(x, y, indexing="ij"), -1)))


@jax.jit
def _heights(floor: GroundPart, point: Float[Array, "3 n"]) -> Float[Array, " n"]:
    gap, normal = floor.distance(point)
    return jnp.broadcast_to(-gap / normal[2], gap.shape)


_STONE = np.array([0.60, 0.57, 0.53])
_SEED = 20102
# Waves that make the grain: number, lowest and highest wave count across the stone. Then the change
# of brightness, and the tilt of the normals.
_WAVES, _LOWEST, _HIGHEST = 60, 2.0, 30.0
_GRAIN, _ROUGHNESS = 0.07, 0.25
# Facets along an edge of a block and around a boulder: for the picture, and for a shadow. A frame
# of 1280 x 720 with five boulders and two blocks took 58 ms. Twice the facets took 82 ms. Without
# the sides that face away it took 43 ms.
_SEEN, _SHADE = (24, 72), (8, 36)
_NO_STONE = "cannot draw a {} as an obstacle. Allowed: Boulder, Block"
# Parts deeper in the ground than this fraction of an obstacle's size are not drawn.
_SUNK = 0.02


def obstacle_mesh(
    obstacle: GroundPart, *, shade: bool = False
) -> tuple[pv.PolyData, np.ndarray, np.ndarray]:
    """Return an obstacle's surface in its frame, its place ``(3,)``, m, and rotation ``(3, 3)``.

    A surface that only casts a shade has fewer facets.

    Raises:
        TypeError: the obstacle is neither a boulder nor a block.
    """
    edge, around = _SHADE if shade else _SEEN
    if isinstance(obstacle, Boulder):
        mesh = pv.Sphere(
            radius=float(obstacle.radius), theta_resolution=around, phi_resolution=around // 2
        )
        return mesh, np.array(obstacle.centre, float), np.eye(3)
    if isinstance(obstacle, Block):
        half = np.array(obstacle.half_extents, float)
        mesh = pv.Box((-1, 1, -1, 1, -1, 1), level=edge, quads=True).triangulate()
        faces = mesh.regular_faces
        mesh = pv.PolyData.from_regular_faces(np.asarray(mesh.points) * half, faces)
        mesh = cast(pv.PolyData, mesh.compute_normals(split_vertices=True, feature_angle=30.0))
        return mesh, np.array(obstacle.centre, float), _heading(obstacle)
    raise TypeError(_NO_STONE.format(type(obstacle).__name__))


def obstacle_top(obstacle: GroundPart, place: np.ndarray) -> np.ndarray:
    """Return the height of an obstacle's upper side at x and y, m, or -inf outside of it.

    Raises:
        TypeError: the obstacle is neither a boulder nor a block.
    """
    if isinstance(obstacle, Boulder):
        offset = place - np.array(obstacle.centre[:2])
        rise = np.sqrt(np.maximum(float(obstacle.radius) ** 2 - (offset**2).sum(-1), 0.0))
        return np.where(rise > 0, obstacle.centre[2] + rise, -np.inf)
    if isinstance(obstacle, Block):
        own = (place - np.array(obstacle.centre[:2])) @ _heading(obstacle)[:2, :2]
        over = (np.abs(own) < obstacle.half_extents[:2]).all(-1)
        return np.where(over, obstacle.centre[2] + obstacle.half_extents[2], -np.inf)
    raise TypeError(_NO_STONE.format(type(obstacle).__name__))


def add_obstacles(
    plotter: pv.Plotter,
    obstacles: Sequence[GroundPart],
    ambient: float,
    height: Callable[[np.ndarray], np.ndarray],
) -> None:
    """Draw obstacles as stones, with rough shading on a smooth surface.

    Buried parts are left out.

    Args:
        plotter: plotter of the picture.
        obstacles: obstacles on the ground.
        ambient: fraction of light that comes from everywhere.
        height: function that returns the drawn ground's height, m, at x and y ``(n, 2)``, m.
    """
    generator = np.random.default_rng(_SEED)
    for obstacle in obstacles:
        mesh, place, turn = obstacle_mesh(obstacle)
        own = np.asarray(mesh.points).astype(float)
        extent = np.ptp(own, axis=0).max()
        size = _LOWEST * (_HIGHEST / _LOWEST) ** generator.random(_WAVES)
        wave = generator.normal(size=(_WAVES, 3))
        wave *= size[:, None] / np.linalg.norm(wave, axis=1, keepdims=True)
        phase = own @ wave.T * (2 * np.pi / extent) + generator.random(_WAVES) * 2 * np.pi
        strength = size**-0.5 / np.sqrt((1 / size).sum() / 2)
        grain = np.cos(phase) @ strength
        tilt = -np.sin(phase) * strength @ (wave / np.linalg.norm(wave, axis=1, keepdims=True))
        normal = np.asarray(mesh.point_data.active_normals) - _ROUGHNESS * tilt
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        mesh.point_data.active_normals = normal
        tone = _STONE * (1 + _GRAIN * grain[:, None])
        mesh["rgb"] = (255 * np.clip(tone, 0, 1)).astype(np.uint8)
        world = own @ turn.T + place
        above = world[:, 2] > height(world[:, :2]) - _SUNK * extent
        if not above.any():
            continue
        mesh.clear_cell_data()
        mesh.regular_faces = mesh.regular_faces[above[mesh.regular_faces].any(1)]
        actor = plotter.add_mesh(
            mesh,
            scalars="rgb",
            rgb=True,
            smooth_shading=True,
            culling="back",
            ambient=ambient,
            diffuse=0.75,
            specular=0.05,
        )
        actor.user_matrix = placed(turn, place)


def _heading(block: Block) -> np.ndarray:
    """Return the rotation ``(3, 3)`` from a block's axes to the world's."""
    c, s = np.cos(block.heading), np.sin(block.heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
