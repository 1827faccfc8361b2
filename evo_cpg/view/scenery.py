"""What surrounds the animal: sea or land, sky, the ground and its marks, light, shadows, trail.

Each ``add_...`` function puts actors into a plotter once. Those that must change from frame to
frame return a function that does it by moving actors or overwriting arrays in place; nothing is
meshed again. Translucent actors are drawn in the order in which they were added: floor, numbers,
shadows, light, trail. The floor writes no depth, so what lies in its plane does not flicker.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple, cast

import numpy as np
import pyvista as pv
from vtkmodules.vtkCommonCore import vtkInformation
from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLActor

from evo_cpg.creature.creature import Creature
from evo_cpg.creature.shapes import Box
from evo_cpg.view.meshes import shape_mesh
from evo_cpg.view.textures import CELLS, floor_texture, spot_texture

_PARTICLES = 1200
_PARTICLE = "#d9fff6"
_PARTICLE_SEED = 20101
# The sun of the land stands to the left of the viewer and behind him, so that it lights the sides
# that he sees and shadows fall away from him: to the right, ahead and up in his picture.
_SUN_SEEN = (-0.62, -0.45, 1.0)
_SUN_AT_SEA = (-0.4, -0.6, 1.6)
# Distance of the sky behind the focus and height over which it turns blue, in distances of the
# camera. The floor has faded away before it gets there.
_SKY, _SKY_HEIGHT = 18.0, 2.6
# Numbers on the ground: height of a digit and distance from the way, in radii of the animal.
# They fade between these shares of the way from the focus to the camera, below which captions are.
_DIGIT, _BESIDE = 0.1, 0.45
_FADES = (0.33, 0.43)
# Opacity of the spot under a foot that touches the ground.
_CONTACT = 0.85


@dataclasses.dataclass(frozen=True)
class Look:
    """Colours and proportions of a world; lengths are relative to the animal's radius.

    Attributes:
        distance: colour of the background, into which the floor fades.
        floor: tints of the floor, from dark to light.
        grid: colour of the grid lines.
        shadow: colour of shadows.
        shadow_strength: opacity of the soft patches under the bodies, 0 to 1.
        cast_strength: opacity of the shadows that the sun casts, 0 to 1; 0 where it casts none.
        sun: colour of the directional light.
        fill: colour of the weak light from the viewer's side.
        ambient: share of light that comes from everywhere.
        trail: colour of the trail.
        light: colour of the glowing sphere.
        halo: colour of the glow around it.
        glow: opacity of the glow and of the pool of light on the floor, 0 to 1.
        text: colour of the captions.
        visibility: distance at which the floor has faded to a third.
        elevation: of the camera above the focus, rad, when it looks towards a light.
        side_elevation: the same when it looks at the animal's side; on land low enough that the
            horizon and what is under the animal are seen.
        particles: whether specks drift in the medium.
        checkered: whether alternate grid cells differ in tone.
        zenith: colour towards which the sky turns above the horizon; None where there is no sky.
    """

    distance: str
    floor: tuple[str, str]
    grid: str
    shadow: str
    shadow_strength: float
    cast_strength: float
    sun: str
    fill: str
    ambient: float
    trail: str
    light: str
    halo: str
    glow: float
    text: str
    visibility: float
    elevation: float
    side_elevation: float
    particles: bool
    checkered: bool
    zenith: str | None


LOOKS = {
    "water": Look(
        distance="#052a3b",
        floor=("#0d4c5c", "#2f8a8c"),
        grid="#8fe0d6",
        shadow="#02141d",
        shadow_strength=0.5,
        cast_strength=0.0,
        sun="#eafcff",
        fill="#7fd0e6",
        ambient=0.34,
        trail="#ffd9a0",
        light="#fffbe6",
        halo="#ffe9a8",
        glow=0.5,
        text="#f2fbff",
        visibility=5.5,
        elevation=np.radians(24),
        side_elevation=np.radians(24),
        particles=True,
        checkered=False,
        zenith=None,
    ),
    "land": Look(
        distance="#ece9e1",
        floor=("#ab9878", "#dccbaa"),
        grid="#75664c",
        shadow="#2a2018",
        shadow_strength=0.28,
        cast_strength=0.42,
        sun="#fff1d6",
        fill="#cfe0f2",
        ambient=0.4,
        trail="#c2410c",
        light="#ffd75e",
        halo="#ffae1a",
        glow=0.3,
        text="#1d2530",
        visibility=16.0,
        elevation=np.radians(18),
        side_elevation=np.radians(11),
        particles=False,
        checkered=True,
        zenith="#7fb0dc",
    ),
}


def grid_spacing(length: float) -> float:
    """Spacing of the floor's grid: 1, 2 or 5 times a power of ten, about half the length (m)."""
    power = 10.0 ** np.floor(np.log10(length / 2))
    return float(power * max(step for step in (1, 2, 5) if step * power <= length / 2 * 1.001))


def mark_spacing(length: float) -> float:
    """Distance between the numbers on the ground, about the length of the animal (m)."""
    return grid_spacing(2.4 * length)


def sun_direction(look: Look, sight: np.ndarray) -> np.ndarray:
    """Unit vector towards the sun.

    Args:
        look: of the world.
        sight: the camera's fixed direction of view ``(3,)``.
    """
    towards = np.array(_SUN_AT_SEA)
    if look.cast_strength:
        ahead = np.array([sight[0], sight[1], 0.0]) / np.hypot(*sight[:2])
        across = np.cross(ahead, [0.0, 0.0, 1.0])
        towards = np.array(_SUN_SEEN) @ np.stack([across, ahead, [0.0, 0.0, 1.0]])
    return towards / np.linalg.norm(towards)


def add_sky(
    plotter: pv.Plotter, look: Look, sight: np.ndarray, away: float
) -> Callable[[np.ndarray], None]:
    """Background, sky and sun.

    A backdrop stands behind the floor's far end: VTK's own gradient costs 18 ms a frame, this 2.

    Args:
        plotter: draws them.
        look: of the world.
        sight: the camera's fixed direction of view ``(3,)``.
        away: distance of the camera from its focus, m.

    Returns:
        A function of the camera's place ``(3,)``, m.
    """
    plotter.background_color = pv.Color(look.distance)
    sun = pv.Light(
        position=tuple(sun_direction(look, sight)), color=look.sun, light_type="scene light"
    )
    sun.intensity = 0.85
    sun.positional = False
    plotter.add_light(sun)
    # Keeps the sides that face the viewer from going black.
    fill = pv.Light(color=look.fill, intensity=0.4, light_type="camera light")
    fill.positional = False
    plotter.add_light(fill)
    if look.zenith is None:
        return lambda eye: None

    ahead = np.array([sight[0], sight[1], 0.0]) / np.hypot(*sight[:2])
    across = np.cross(ahead, [0.0, 0.0, 1.0])
    blue = np.linspace(0, 1, 12)
    height = _SKY_HEIGHT * away * np.concatenate([blue, [10.0]])
    share = np.append(1 - (1 - blue) ** 2, 1.0)[:, None]
    haze, zenith = (np.array(pv.Color(color).int_rgb) for color in (look.distance, look.zenith))
    middle = _SKY * away * ahead + height[:, None] * [0.0, 0.0, 1.0]
    side = 2 * _SKY * away * across
    points = np.stack([middle - side, middle + side], 1)
    backdrop = pv.StructuredGrid(*(points[..., i, None] for i in range(3)))
    backdrop = backdrop.extract_surface(algorithm=None)
    # A structured grid counts its first axis fastest.
    backdrop["rgb"] = np.tile(haze + share * (zenith - haze), (2, 1)).astype(np.uint8)
    actor = plotter.add_mesh(
        backdrop, scalars="rgb", rgb=True, lighting=False, show_scalar_bar=False
    )

    def update(eye: np.ndarray) -> None:
        actor.position = tuple(eye)

    return update


class Marks(NamedTuple):
    """Where the pattern of the ground lies, along which the animal's way can be read.

    Attributes:
        origin: of the pattern and its numbers ``(2,)``, m.
        course: bearing of the numbers from the x axis, rad.
        spacing: distance between the numbers, m.
    """

    origin: np.ndarray
    course: float
    spacing: float

    def turn(self) -> np.ndarray:
        """Rotation from the pattern's axes to the world's ``(2, 2)``."""
        c, s = np.cos(self.course), np.sin(self.course)
        return np.array([[c, -s], [s, c]])


def add_floor(
    plotter: pv.Plotter,
    look: Look,
    height: float,
    radius: float,
    spacing: float,
    marks: Marks | None = None,
) -> Callable[[np.ndarray], None]:
    """A floor that reaches to the horizon.

    It is a disc that travels below the focus, while its texture stays where it is in the world.

    Args:
        plotter: draws it.
        look: of the world.
        height: z of the floor, m.
        radius: of the animal, m.
        spacing: of the grid, m.
        marks: lie on the ground, with a strong line at each number; None where there are none.

    Returns:
        A function of the focus ``(3,)``, m.
    """
    visible = look.visibility * radius
    reach = np.concatenate([[0.0], np.geomspace(0.2, 3.0, 28)]) * visible
    bearing = np.linspace(0, 2 * np.pi, 49)
    x = reach[:, None] * np.cos(bearing)
    y = reach[:, None] * np.sin(bearing)
    grid = pv.StructuredGrid(x[..., None], y[..., None], np.zeros_like(x)[..., None])
    disc = grid.extract_surface(algorithm=None)
    place = np.asarray(disc.points)[:, :2].copy()
    fade = np.exp(-((np.linalg.norm(place, axis=1) / visible) ** 2))
    disc["rgba"] = np.column_stack([np.full((len(place), 3), 255), 255 * fade]).astype(np.uint8)
    disc.active_texture_coordinates = place / (CELLS * spacing)
    texture = floor_texture(look.floor, look.grid, look.checkered, marks is not None)
    actor = plotter.add_mesh(
        disc, scalars="rgba", rgba=True, texture=texture, lighting=False, show_scalar_bar=False
    )
    origin, turn = (marks.origin, marks.turn()) if marks else (np.zeros(2), np.eye(2))

    def update(focus: np.ndarray) -> None:
        actor.position = (focus[0], focus[1], height)
        world = place + focus[:2] - origin
        disc.active_texture_coordinates = world @ turn / (CELLS * spacing)

    return update


def add_numbers(
    plotter: pv.Plotter,
    look: Look,
    marks: Marks,
    path: np.ndarray,
    height: float,
    radius: float,
    sight: np.ndarray,
    away: float,
) -> Callable[[np.ndarray], None]:
    """Distances from the start, painted on the ground on the viewer's side of the way.

    Args:
        plotter: draws them.
        look: of the world.
        marks: where they lie.
        path: of the animal ``(frames, 3)``, m.
        height: z of the ground, m.
        radius: of the animal, m.
        sight: the camera's fixed direction of view ``(3,)``, from which they are read.
        away: distance of the camera from its focus, m.

    Returns:
        A function of the focus ``(3,)``, m.
    """
    along = (path[:, :2] - marks.origin) @ marks.turn()
    ahead = sight[:2] / np.hypot(*sight[:2])
    across = np.array([ahead[1], -ahead[0]])
    # Beside the way, where the animal does not tread on them even if it sways.
    nearer = -np.sign(ahead @ marks.turn()[:, 1]) or -1.0
    side = nearer * (nearer * along[:, 1]).max() + nearer * _BESIDE * radius
    last = int(np.ceil((along[:, 0].max() + 2 * radius) / marks.spacing))
    first = int(np.floor(min(along[:, 0].min(), 0.0) / marks.spacing))
    size = _DIGIT * radius
    # Lying flat they look as low as the sight is slanting.
    stretch = 0.7 / max(-sight[2] / np.linalg.norm(sight), 0.15)
    digits = []
    for count in range(first, last + 1):
        digit = pv.Text3D(f"{count * marks.spacing:g} m", depth=0.0, height=size, center=(0, 0, 0))
        flat = np.asarray(digit.points)[:, :2] * [1.0, stretch]
        middle = marks.origin + marks.turn() @ [count * marks.spacing, side]
        # To the right of its line.
        flat[:, 0] += 0.7 * size - flat[:, 0].min()
        place = middle + flat @ np.stack([across, ahead])
        digit.points = np.column_stack([place, np.full(len(place), height)])
        digits.append(digit)
    mesh = pv.merge(digits).extract_surface(algorithm=None)
    place = np.asarray(mesh.points)[:, :2].copy()
    rgba = np.tile(pv.Color(look.text).int_rgba, (len(place), 1)).astype(np.uint8)
    mesh["rgba"] = rgba
    actor = plotter.add_mesh(mesh, scalars="rgba", rgba=True, lighting=False, show_scalar_bar=False)
    actor.ForceTranslucentOn()

    def update(focus: np.ndarray) -> None:
        offset = place - focus[:2]
        gone = np.linalg.norm(offset, axis=1) / (0.4 * look.visibility * radius)
        near = np.interp(-(offset @ ahead) / away, _FADES, (1.0, 0.0))
        rgba[:, 3] = 200 * near * np.exp(-(gone**2))
        mesh["rgba"] = rgba

    return update


def add_sun_shadows(
    plotter: pv.Plotter, look: Look, creature: Creature, height: float, sun: np.ndarray
) -> Callable[[np.ndarray, np.ndarray], None]:
    """The shadows that the bodies cast on the floor in the sun: the bodies, flattened along it.

    Args:
        plotter: draws them.
        look: of the world; nothing is drawn where it casts no shadows.
        creature: the animal.
        height: z of the floor, m.
        sun: unit vector towards the sun ``(3,)``.

    Returns:
        A function of the bodies' centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``.
    """
    if not look.cast_strength:
        return lambda position, rotation: None
    flatten = np.eye(4)
    flatten[:2, 2] = -sun[:2] / sun[2]
    flatten[2, 2] = 0.0
    actors = []
    for body in creature.bodies:
        actor = plotter.add_mesh(
            shape_mesh(body.shape),
            color=look.shadow,
            opacity=look.cast_strength,
            lighting=False,
            culling="back",
        )
        # Of a body only the sunny side is flattened. Shadows write their depth, each a little
        # below the one before, so that where two overlap the floor is darkened once.
        keys = vtkInformation()
        keys.Set(vtkOpenGLActor.GLDepthMaskOverride(), 1)
        actor.SetPropertyKeys(keys)
        actors.append(actor)
    layer = 1e-3 * min(body.shape.half_extents.min() for body in creature.bodies)

    def update(position: np.ndarray, rotation: np.ndarray) -> None:
        for i, (actor, centre, turn) in enumerate(zip(actors, position, rotation, strict=True)):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = turn, centre - [0.0, 0.0, height]
            matrix = flatten @ pose
            matrix[2, 3] = height - i * layer
            actor.user_matrix = matrix

    return update


def add_contacts(
    plotter: pv.Plotter, look: Look, creature: Creature, height: float
) -> Callable[[np.ndarray, np.ndarray], None]:
    """Dark soft spots where bodies touch the ground; they pale as the gap opens.

    Args:
        plotter: draws them.
        look: of the world.
        creature: the animal.
        height: z of the ground, m.

    Returns:
        A function of the bodies' centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``.
    """
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    patch = pv.Plane(i_size=2, j_size=2, i_resolution=1, j_resolution=1)
    texture = spot_texture(look.shadow, _CONTACT, sharpness=2.6)
    spots = []
    for body in creature.bodies:
        # Meshes of boxes are rounded, the physics' boxes are not.
        sharp = isinstance(body.shape, Box)
        points = np.asarray(shape_mesh(body.shape).points)
        points = corners * body.shape.half_extents if sharp else points
        actor = plotter.add_mesh(patch, texture=texture, lighting=False)
        actor.ForceTranslucentOn()
        spots.append((actor, points, float(body.shape.half_extents.min())))

    def update(position: np.ndarray, rotation: np.ndarray) -> None:
        for (actor, points, size), centre, turn in zip(spots, position, rotation, strict=True):
            place = centre + points @ turn.T
            gap = place[:, 2].min() - height
            weight = np.exp(-(place[:, 2] - place[:, 2].min()) / (0.25 * size))
            weight /= weight.sum()
            middle = weight @ place[:, :2]
            offset = place[:, :2] - middle
            ellipse = (weight * offset.T) @ offset + (0.6 * size) ** 2 * np.eye(2)
            spread, axes = np.linalg.eigh(ellipse)
            matrix = np.eye(4)
            matrix[:2, :2] = axes * np.sqrt(spread) * 2.2
            matrix[:3, 3] = *middle, height
            actor.user_matrix = matrix
            actor.prop.opacity = float(np.exp(-max(gap, 0.0) / (0.5 * size)))

    return update


def add_shadows(
    plotter: pv.Plotter, look: Look, height: float, half_extents: np.ndarray
) -> Callable[[np.ndarray, np.ndarray], None]:
    """Soft patches on the floor under the bodies.

    Args:
        plotter: draws them.
        look: of the world.
        height: z of the floor, m.
        half_extents: of the bodies ``(bodies, 3)``, m.

    Returns:
        A function of the bodies' centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``.
    """
    patch = pv.Plane(i_size=2, j_size=2, i_resolution=1, j_resolution=1)
    texture = spot_texture(look.shadow, look.shadow_strength, sharpness=2.2)
    actors = [
        plotter.add_mesh(patch, texture=texture, lighting=False) for _ in range(len(half_extents))
    ]

    def update(position: np.ndarray, rotation: np.ndarray) -> None:
        for actor, centre, turn, half in zip(actors, position, rotation, half_extents, strict=True):
            # Higher above the floor the patch is wider: the sky lights its edge.
            blur = 0.9 * half.min() + 0.12 * max(centre[2] - height, 0.0)
            ellipse = (turn[:2] * half) @ (turn[:2] * half).T + blur**2 * np.eye(2)
            spread, axes = np.linalg.eigh(ellipse)
            matrix = np.eye(4)
            matrix[:2, :2] = axes * np.sqrt(spread) * 1.25
            matrix[:3, 3] = centre[0], centre[1], height
            actor.user_matrix = matrix

    return update


def add_light(
    plotter: pv.Plotter,
    look: Look,
    goal: np.ndarray,
    height: float,
    radius: float,
    sight: np.ndarray,
) -> None:
    """The goal: a glowing sphere, its halo, its pool on the floor, and the light it sheds.

    Args:
        plotter: draws it.
        look: of the world.
        goal: place of the light ``(3,)``, m.
        height: z of the floor, m.
        radius: of the animal, m.
        sight: the camera's fixed direction of view ``(3,)``, which the halo faces.
    """
    pool = pv.Plane(
        center=(goal[0], goal[1], height),
        i_size=3.6 * radius,
        j_size=3.6 * radius,
        i_resolution=1,
        j_resolution=1,
    )
    shine = spot_texture(look.halo, look.glow, sharpness=3.0)
    plotter.add_mesh(pool, texture=shine, lighting=False)
    core = 0.075 * radius
    plotter.add_mesh(
        pv.Sphere(radius=core, center=goal, theta_resolution=32, phi_resolution=24),
        color=look.light,
        lighting=False,
    )
    for size, strength, sharpness in ((1.6 * radius, look.glow, 3.6), (4.5 * core, 0.95, 2.4)):
        halo = pv.Plane(
            center=goal - 1.05 * core * sight,
            direction=-sight,
            i_size=size,
            j_size=size,
            i_resolution=1,
            j_resolution=1,
        )
        texture = spot_texture(look.halo, strength, sharpness)
        plotter.add_mesh(halo, texture=texture, lighting=False)
    lamp = pv.Light(position=goal, color=look.halo, intensity=0.9, light_type="scene light")
    lamp.positional = True
    lamp.cone_angle = 90
    lamp.attenuation_values = (1.0, 0.0, (0.7 / radius) ** 2)
    plotter.add_light(lamp)


def add_particles(
    plotter: pv.Plotter, path: np.ndarray, floor: float, radius: float, scale: float
) -> None:
    """Specks at rest in the world, against which motion shows.

    Args:
        plotter: draws them.
        path: points around which they float ``(n, 3)``, m.
        floor: z below which there are none, m.
        radius: of the animal, m.
        scale: pixels rendered per pixel of the film.
    """
    generator = np.random.default_rng(_PARTICLE_SEED)
    low, high = path.min(0) - 3 * radius, path.max(0) + 3 * radius
    low[2], high[2] = floor, path[:, 2].max() + 1.2 * radius
    points = generator.uniform(low, high, (_PARTICLES, 3))
    for chosen, size, opacity in ((points[::4], 2.1, 0.5), (points[1::2], 1.3, 0.35)):
        plotter.add_mesh(
            pv.PolyData(chosen),
            color=_PARTICLE,
            opacity=opacity,
            point_size=size * scale,
            lighting=False,
        )


def add_trail(
    plotter: pv.Plotter, look: Look, path: np.ndarray, thickness: float, fade: float
) -> Callable[[int], None]:
    """A fading thread along the way that a body has come.

    The whole thread is meshed once; each frame only says how much of it shows.

    Args:
        plotter: draws it.
        look: of the world.
        path: of the body ``(frames, 3)``, m.
        thickness: radius of the thread, m.
        fade: number of frames after which it has faded to a third.

    Returns:
        A function of the frame's number.
    """
    moved = np.linalg.norm(np.diff(path, axis=0), axis=1) > thickness / 10
    kept = np.flatnonzero(np.concatenate([[True], moved]))
    if len(kept) < 2:
        return lambda frame: None
    line = pv.lines_from_points(path[kept])
    line["frame"] = kept.astype(float)
    tube = cast(pv.PolyData, line.tube(radius=thickness, n_sides=6, capping=False))
    born = np.asarray(tube.point_data["frame"])
    rgba = np.tile(pv.Color(look.trail, opacity=0).int_rgba, (len(born), 1)).astype(np.uint8)
    tube.point_data["rgba"] = rgba
    # Drawn as translucent from the first frame on, when nothing of it shows yet.
    actor = plotter.add_mesh(tube, scalars="rgba", rgba=True, lighting=False, culling="back")
    actor.ForceTranslucentOn()

    def update(frame: int) -> None:
        age = frame - born
        alpha = np.where(age >= 0, 0.75 * np.exp(-age / fade), 0.0)
        rgba[:, 3] = 255 * alpha
        tube.point_data["rgba"] = rgba

    return update
