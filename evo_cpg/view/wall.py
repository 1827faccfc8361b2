"""A wall: animals with different bodies side by side, each in motion in a cell of a grid.

All have one scale. Each animal is turned so that its course runs to the right and towards the
viewer, and stays in its cell, because its smoothed path is subtracted. In water the cells are
upright. On land they lie on the ground, and the pattern below each animal moves instead of it.

All bodies are one mesh, because hundreds of actors take seconds to draw. Each frame overwrites its
points and normals.
"""

import colorsys
import itertools
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pyvista as pv
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.colors import to_hex

from evo_cpg.creature.creature import Creature
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Plane
from evo_cpg.view.camera import ACROSS, BodyBoxes, CameraPath, course, overview, smooth
from evo_cpg.view.look import STYLES
from evo_cpg.view.meshes import pieces, surfaces
from evo_cpg.view.offscreen import CELLS, add_faded, floor_texture
from evo_cpg.view.scene import Clip, Exhibit, Panel, Scene, Wall, grid_spacing, sample_at, scene_of
from evo_cpg.view.scenery import add_particles, add_sky
from evo_cpg.view.shadows import add_contacts, add_shadows, add_sun_shadows
from evo_cpg.view.skin import drape
from evo_cpg.view.stage import Shot, Stage, Update
from evo_cpg.view.terrain import heights

# Bearing of all courses: to the right, and this angle towards the viewer, rad.
_TURNED = -np.radians(38.0)
# Standard deviation of the window over which paths are smoothed, s.
_CALM = 0.8
# Room around the animal at the quantile of all sizes that fills a cell, and fraction of the largest
# animal that a cell holds. Instants at which an animal is larger are ignored up to a quantile.
_ROOM, _QUANTILE, _LARGEST, _RARE = 1.1, 0.9, 0.85, 0.05
# Elevations of the camera, rad: before an upright wall, and above the ground.
_UPRIGHT, ELEVATION = np.radians(6.0), np.radians(38.0)
# View, degrees: narrow and from far away, so that all animals are seen from the same side. Room for
# captions, relative to the height of the wall.
_NARROW, _CAPTIONS = 5.0, 0.05
# Fraction of light from everywhere: dark sides would look like the water behind them.
_AMBIENT = 0.5
# Height of a swimmers' floor below the lowest row, and side of a tile, in cells.
_BELOW, TILE = 0.55, 0.96
# Width over height of the part of the picture for the animals, relative to the whole picture.
_WIDER = 1.15


def colors_of_lines(founders: Sequence[int | None], world: str) -> list[str]:
    """Return a colour for each animal: a hue for each line, or a shade of the rank if unknown.

    Hues of the largest lines differ most, because each is a golden angle from the one before.

    Args:
        founders: ancestor of each animal in generation 0, the fittest animal first.
        world: medium, ``water`` or ``land``.
    """
    light, strength = (0.64, 0.72) if world == "water" else (0.5, 0.6)
    if None in founders:
        shades = colormaps["plasma"](np.linspace(0.95, 0.4, len(founders)))
        return [to_hex(shade) for shade in shades]
    ranks = {line: rank for rank, (line, _) in enumerate(Counter(founders).most_common())}
    golden = (3 - 5**0.5) / 2
    hues = [(0.07 + golden * ranks[line]) % 1 for line in founders]
    return [to_hex(colorsys.hls_to_rgb(hue, light, strength)) for hue in hues]


def hung(panel: Panel, clip: Clip, aspect: float) -> Scene:
    """Return the scene of a wall at the instants of a clip.

    Args:
        panel: the animals.
        clip: motion of any of them.
        aspect: width of the picture over its height.
    """
    stands = panel.ground is not None
    scene, upright = scene_of(panel, clip), 1 if stands else 2
    shown = [_in_place(one, clip, panel.ground) for one in panel.exhibits]
    pairs = zip(panel.exhibits, shown, strict=True)
    boxes = np.array([_box(motion, one.creature) for one, (motion, _) in pairs])
    sizes, centres = np.ptp(boxes, axis=1), boxes.mean(1)
    if stands:
        # A row does not hide the row behind it: the height adds to the depth, on the far side.
        behind = boxes[:, 1, 2] / np.tan(ELEVATION)
        sizes[:, 1] += behind
        centres += np.stack([0 * behind, behind / 2, -centres[:, 2]], axis=1)
    else:
        # From a little above, the depth is seen as height.
        sizes[:, 2] += sizes[:, 1] * np.tan(_UPRIGHT)
    sizes = sizes[:, [0, upright]]
    cell = np.maximum(_ROOM * np.quantile(sizes, _QUANTILE, axis=0), _LARGEST * sizes.max(0))
    seen = cell[1] * np.sin(ELEVATION) if stands else cell[1]
    middles = _grid(len(shown), cell, upright, _WIDER * aspect * seen / cell[0])
    shifts = zip(shown, middles - centres, strict=True)
    place = np.concatenate([motion.position + shift for (motion, _), shift in shifts], axis=1)
    turn = np.concatenate([motion.rotation for motion, _ in shown], axis=1)
    drift = np.stack([path for _, path in shown], axis=1)
    wall = Wall(tuple(one.creature for one in panel.exhibits), middles, cell, drift)
    low = 0.0 if stands else float(middles[:, 2].min() - _BELOW * 2 * cell[1])
    radius = float(np.median(sizes[:, 0]) / 2)
    marks = scene.marks._replace(spacing=CELLS * grid_spacing(2 * radius))
    every = clip._replace(position=place, rotation=turn)
    return scene._replace(
        clip=every, goal=None, ground=Ground(floor=Plane(height=low)), surface=None,
        look=STYLES[panel.world], radius=radius, marks=marks, wall=wall,
    )  # fmt: skip


def _in_place(one: Exhibit, clip: Clip, ground: Ground | None) -> tuple[Clip, np.ndarray]:
    """Return an animal's motion without its path, turned, and the level path ``(frames, 2)``."""
    own = sample_at(one.recording, clip.time, clip.rate)
    centre = own.position.mean(1)
    path, least = smooth(centre, _CALM * clip.rate), float(np.ptp(own.position[0], axis=0).max())
    if ground is not None:
        # The height above the ground stays.
        path[:, 2] = heights(ground.floor, path[:, :2])
    c, s = (f(_TURNED - course(centre, np.full(3, np.nan), least / 4)) for f in (np.cos, np.sin))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    place = (own.position - path[:, None]) @ turn.T
    return own._replace(position=place, rotation=turn @ own.rotation), (path @ turn.T)[:, :2]


def _box(motion: Clip, creature: Creature) -> Float[np.ndarray, "2 3"]:
    """Return the lowest and highest coordinates of an animal over nearly all instants, m."""
    half = np.array([body.shape.half_extents for body in creature.bodies])
    corners = BodyBoxes(motion.position, motion.rotation, half).corners()
    ends = (corners.min(1), _RARE), (corners.max(1), 1 - _RARE)
    return np.array([np.quantile(values, part, axis=0) for values, part in ends])


def _grid(count: int, cell: np.ndarray, upright: int, aspect: float) -> Float[np.ndarray, "n 3"]:
    """Return the middles of cells, row by row from the top, m. The last row is centred.

    With their number of columns, the cells are largest in a picture of some cells' aspect.
    """
    tried = np.arange(1, count + 1)
    columns = tried[np.minimum(aspect / tried, 1 / np.ceil(count / tried)).argmax()]
    row, column = np.divmod(np.arange(count), columns)
    length = np.minimum(columns, count - row * columns)
    middles = np.zeros((count, 3))
    middles[:, 0] = (column - (length - 1) / 2) * cell[0]
    middles[:, upright] = (row[-1] / 2 - row) * cell[1]
    return middles


def wall_view(scene: Scene, aspect: float) -> CameraPath:
    """Return the camera before a wall, which rests."""
    wall = scene.wall
    assert wall is not None
    half, upright = np.zeros(3), 1 if scene.stands else 2
    half[[0, upright]] = wall.cell / 2
    points = np.concatenate([wall.middles - half, wall.middles + half])
    # The captions are higher than in an overview.
    points[points[:, upright].argmin(), upright] -= _CAPTIONS * np.ptp(points[:, upright])
    elevation = ELEVATION if scene.stands else _UPRIGHT
    path = overview(points, np.pi / 2 - ACROSS, elevation, aspect, view_angle=_NARROW)
    place, focus = (np.tile(x, (len(scene.clip.time), 1)) for x in path[:2])
    return CameraPath(place, focus, path.view_angle)


def add_wall(stage: Stage) -> list[Update]:
    """Draw a wall and everything around it."""
    scene, look = stage.scene, stage.look
    assert scene.wall is not None
    updates = [add_sky(stage)]
    if scene.stands:
        updates.append(_add_tiles(stage, scene.wall))
        meshes = [mesh for one in scene.wall.creatures for mesh in surfaces(one, fine=False)]
        updates.append(add_sun_shadows(stage, meshes))
        updates += [add_shadows(stage, scene.half_extents), add_contacts(stage)]
    if look.particles:
        add_particles(stage)
    return [*updates, _add_animals(stage, scene.wall)]


def _add_tiles(stage: Stage, wall: Wall) -> Update:
    """Draw a tile of ground in each cell, whose pattern moves back as the animal goes ahead."""
    look, count = stage.look, len(wall.middles)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * wall.cell * TILE / 2
    points = np.zeros((count, 4, 3))
    points[..., :2] = wall.middles[:, None, :2] + corners
    mesh = pv.PolyData.from_regular_faces(
        points.reshape(-1, 3), np.arange(4 * count).reshape(-1, 4)
    )
    mesh.active_texture_coordinates = np.zeros((4 * count, 2))
    texture = floor_texture(look.floor, look.grid, look.checkered)
    rgba = np.full((4 * count, 4), 255, np.uint8)
    add_faded(stage.plotter, mesh, rgba, texture=texture)

    def update(shot: Shot) -> None:
        under = (wall.drift[shot.number][:, None] + corners).reshape(-1, 2)
        mesh.active_texture_coordinates = under / stage.scene.marks.spacing

    return update


def _add_animals(stage: Stage, wall: Wall) -> Update:
    """Draw all bodies and eyes in one mesh, and the skins."""
    found = [own for creature in wall.creatures for own in pieces(creature, fine=False)]
    every = [piece for own in found for piece in own]
    points, normals, faces = zip(*(piece.arrays() for piece in every), strict=True)
    first = np.cumsum([0, *map(len, points)])
    own_points, own_normals = (np.concatenate(x).astype(np.float32) for x in (points, normals))
    # Points of each body and its eyes.
    ends = first[np.cumsum([0, *map(len, found)])]
    parts = [slice(*pair) for pair in itertools.pairwise(ends)]
    joined = np.concatenate([own + i for own, i in zip(faces, first, strict=False)])
    mesh = pv.PolyData.from_regular_faces(own_points, joined)
    mesh["rgb"] = np.concatenate([piece.colors for piece in every])
    mesh.point_data.active_normals = own_normals
    actor = stage.plotter.add_mesh(
        mesh, scalars="rgb", rgb=True, show_scalar_bar=False, culling="back",
        ambient=_AMBIENT, diffuse=0.65, specular=0.2, specular_power=18,
    )  # fmt: skip
    # Only this makes VTK read the normals, which change from frame to frame.
    actor.prop.interpolation = "Phong"
    count = np.cumsum([0, *(len(creature.bodies) for creature in wall.creatures)])
    draped = [
        (slice(*pair), skin)
        for pair, creature in zip(itertools.pairwise(count), wall.creatures, strict=True)
        for skin, _ in drape(stage.plotter, creature, _AMBIENT)
    ]

    def update(shot: Shot) -> None:
        places, outwards = np.empty_like(own_points), np.empty_like(own_normals)
        for part, centre, turn in zip(parts, shot.position, shot.rotation, strict=True):
            turn = turn.T.astype(np.float32)
            np.matmul(own_points[part], turn, out=places[part])
            places[part] += centre.astype(np.float32)
            np.matmul(own_normals[part], turn, out=outwards[part])
        mesh.points = places
        mesh.point_data.active_normals = outwards
        mesh.Modified()
        for own, skin in draped:
            skin.move(shot.position[own], shot.rotation[own])

    return update
