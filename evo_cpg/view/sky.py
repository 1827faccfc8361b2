"""Sun, fill light, background and, on land, the sky."""

from collections.abc import Callable

import numpy as np
import pyvista as pv

from evo_cpg.view.look import Look

# The sun of the land stands to the left of the viewer and behind him, so that it lights the sides
# that he sees and shadows fall away from him: to the right, ahead and up in his picture.
_SUN_SEEN = (-0.62, -0.45, 1.0)
_SUN_AT_SEA = (-0.4, -0.6, 1.6)
# Distance of the sky behind the focus and height over which it turns blue, in distances of the
# camera. The floor has faded away before it gets there.
_SKY, _SKY_HEIGHT = 18.0, 2.6


def sun_direction(look: Look, sight: np.ndarray) -> np.ndarray:
    """Unit vector towards the sun.

    Args:
        look: of the world.
        sight: the camera's direction of view in the first frame ``(3,)``.
    """
    towards = np.array(_SUN_AT_SEA)
    if look.cast_strength:
        across, ahead = _level_axes(sight)
        towards = np.array(_SUN_SEEN) @ np.stack([across, ahead, [0.0, 0.0, 1.0]])
    return towards / np.linalg.norm(towards)


def add_sky(
    plotter: pv.Plotter, look: Look, sight: np.ndarray, away: float
) -> Callable[[np.ndarray, float], None]:
    """Background, sky and sun.

    A backdrop stands behind the floor's far end: VTK's own gradient costs 18 ms a frame, this 2.

    Args:
        plotter: draws them.
        look: of the world.
        sight: the camera's direction of view in the first frame ``(3,)``.
        away: distance of the camera from its focus, m.

    Returns:
        A function of the camera's place ``(3,)``, m, and how far it has turned since, rad.
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
        return lambda eye, turned: None

    across, ahead = _level_axes(sight)
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

    def update(eye: np.ndarray, turned: float) -> None:
        actor.position = tuple(eye)
        actor.orientation = (0.0, 0.0, float(np.degrees(turned)))

    return update


def _level_axes(sight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Level unit vectors to the right and ahead in the picture ``(3,)``."""
    ahead = np.array([sight[0], sight[1], 0.0]) / np.hypot(*sight[:2])
    return np.cross(ahead, [0.0, 0.0, 1.0]), ahead
