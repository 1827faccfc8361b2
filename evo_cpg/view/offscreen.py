"""An off-screen picture: plotter, kinds of actors, and textures made from seeded noise.

Opposite edges of a floor tile match, so that it repeats without a seam.
"""

import contextlib
from collections.abc import Iterator
from typing import Any, cast

import numpy as np
import pyvista as pv
from vtkmodules.vtkCommonCore import vtkInformation
from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLActor


@contextlib.contextmanager
def canvas(size: tuple[int, int]) -> Iterator[pv.Plotter]:
    """Open a plotter of a width and height (pixels) that needs no display."""
    # VTK warns that there is no X server before it uses EGL.
    with pv.vtk_verbosity("error"):
        plotter = pv.Plotter(off_screen=True, window_size=list(size), lighting="none")
        # Multisampling costs 80 ms for a frame of 1280 x 720 on a software renderer. Averaging a
        # larger picture costs a third of that.
        plotter.disable_anti_aliasing()
        # Draw translucent actors in the order of adding. Sorting them by pixel costs 100 ms.
        plotter.renderer.SetUseOIT(False)
        try:
            yield plotter
        finally:
            plotter.close()


def add_faded(plotter: pv.Plotter, mesh: pv.PolyData, rgba: np.ndarray, **given: Any) -> pv.Actor:
    """Draw a mesh unlit, in colours and opacities ``rgba`` of its points: bytes ``(points, 4)``.

    Further arguments are those of `pyvista.Plotter.add_mesh`.
    """
    mesh.point_data["rgba"] = rgba
    actor = plotter.add_mesh(mesh, scalars="rgba", rgba=True, lighting=False, **given)
    actor.ForceTranslucentOn()
    return actor


def grid_triangles(grid: np.ndarray) -> np.ndarray:
    """Return the triangles between neighbours in a grid ``(rows, columns)`` of points' indices."""
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    corners = [np.stack(each, -1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))]
    return np.concatenate(corners)


def smooth_surface(points: np.ndarray, triangles: np.ndarray) -> pv.PolyData:
    """Return a surface with the mean normals of the triangles around each point."""
    surface = pv.PolyData.from_regular_faces(points, triangles)
    made = surface.compute_normals(
        cell_normals=False, split_vertices=False, consistent_normals=False
    )
    return cast(pv.PolyData, made)


def placed(rotation: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the matrix ``(4, 4)`` of an actor that is turned and then moved."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, centre
    return matrix


def write_depth(actor: pv.Actor) -> None:
    """Make a translucent actor hide later actors that lie behind it."""
    keys = vtkInformation()
    keys.Set(vtkOpenGLActor.GLDepthMaskOverride(), 1)
    actor.SetPropertyKeys(keys)


# Grid cells along a side of a floor tile, and texels along a side.
CELLS = 4
_TEXELS = 1024
_SEED = 20100
_SPOT_TEXELS = 128


def floor_texture(
    tints: tuple[str, str], grid: str, checkered: bool, marked: bool = False
) -> pv.Texture:
    """Return a texture of ground with a grid, checkered or under a net of light as in water.

    Args:
        tints: tints of the ground, from dark to light.
        grid: colour of the lines.
        checkered: whether alternate grid cells differ in tone. If not, the ground has a net of
            light.
        marked: whether the tile's own borders are strong lines.
    """
    dark, light = (np.array(pv.Color(color).int_rgb, float) for color in tints)
    relief = _periodic_noise(2, 10)
    grain = _periodic_noise(60, 250)
    tone = 0.42 + 0.16 * relief + 0.05 * grain
    if checkered:
        cell = np.arange(_TEXELS) * CELLS // _TEXELS
        tone += np.where((cell[:, None] + cell) % 2, 0.2, -0.2) - 0.08 * relief
    else:
        tone += 0.42 * _caustics()
    colour = dark + np.clip(tone, 0, 1.25)[..., None] * (light - dark)
    texel = np.arange(_TEXELS) % (_TEXELS // CELLS)
    line = np.exp(-((np.minimum(texel, _TEXELS // CELLS - texel) / 2.0) ** 2))
    on_grid = 0.55 * np.maximum(line[:, None], line)[..., None]
    if marked:
        edge = np.arange(_TEXELS)
        strong = np.exp(-((np.minimum(edge, _TEXELS - edge) / 7.0) ** 4))
        on_grid = np.maximum(0.55 * on_grid, 0.9 * np.maximum(strong[:, None], strong)[..., None])
    colour += on_grid * (np.array(pv.Color(grid).int_rgb) - colour)
    return tile_texture(np.clip(colour, 0, 255).astype(np.uint8))


def light_texture(tints: tuple[str, str]) -> pv.Texture:
    """Return a texture of a net of light, between two tints from dark to light."""
    dark, light = (np.array(pv.Color(color).int_rgb, float) for color in tints)
    tone = np.clip(0.2 + 0.2 * _periodic_noise(2, 10) + 0.6 * _caustics(), 0, 1)
    return tile_texture((dark + tone[..., None] * (light - dark)).astype(np.uint8))


def tile_texture(image: np.ndarray) -> pv.Texture:
    """Return a texture that repeats an image ``(n, n, channels)`` of bytes."""
    texture = pv.Texture(image)
    texture.repeat = True
    texture.interpolate = True
    texture.mipmap = True
    # VTK's default of 4 samples doubles the time of a frame, and fading hides the far blur.
    texture.SetMaximumAnisotropicFiltering(1)
    return texture


def spot_texture(color: str, strength: float, sharpness: float) -> pv.Texture:
    """Return a round spot whose opacity falls smoothly from ``strength`` to 0 at the edge.

    Args:
        color: colour of the spot.
        strength: largest opacity, 0 to 1.
        sharpness: narrowness of the bright middle in ``exp(-sharpness r^2)``.
    """
    axis = np.linspace(-1, 1, _SPOT_TEXELS)
    distance = np.hypot(axis[:, None], axis)
    bell = np.exp(-sharpness * distance**2) - np.exp(-sharpness)
    alpha = np.clip(strength * bell / (1 - np.exp(-sharpness)), 0, 1)
    image = np.empty((*alpha.shape, 4), np.uint8)
    image[..., :3] = pv.Color(color).int_rgb
    image[..., 3] = 255 * alpha
    texture = pv.Texture(image)
    texture.interpolate = True
    return texture


def _periodic_noise(lowest: float, highest: float) -> np.ndarray:
    """Return a random field of unit variance, with wavelengths of 1/highest to 1/lowest tiles."""
    generator = np.random.default_rng(int(_SEED + 1000 * lowest + highest))
    frequency = np.hypot(
        np.fft.fftfreq(_TEXELS, 1 / _TEXELS)[:, None], np.fft.rfftfreq(_TEXELS, 1 / _TEXELS)
    )
    band = (frequency >= lowest) & (frequency <= highest)
    spectrum = band * np.exp(2j * np.pi * generator.random(frequency.shape)) / (1 + frequency)
    field = np.fft.irfft2(spectrum, (_TEXELS, _TEXELS))
    return field / field.std()


def _caustics() -> np.ndarray:
    """Return a net of light made by waves, 0 to 1: borders of warped random cells."""
    generator = np.random.default_rng(_SEED)
    seeds = generator.random((45, 2))
    axis = np.arange(_TEXELS, dtype=np.float32) / _TEXELS
    warp_x, warp_y = (0.012 * _periodic_noise(low, low + 4).astype(np.float32) for low in (2, 3))
    x, y = axis[:, None] + warp_x, axis + warp_y
    nearest = np.full((_TEXELS, _TEXELS), np.inf, np.float32)
    second = nearest.copy()
    for seed_x, seed_y in seeds.astype(np.float32):
        dx, dy = x - seed_x, y - seed_y
        distance = np.hypot(dx - np.rint(dx), dy - np.rint(dy))
        np.minimum(second, np.maximum(nearest, distance), out=second)
        np.minimum(nearest, distance, out=nearest)
    return np.exp(-(second - nearest) / 0.014) * (0.65 + 0.35 * np.tanh(_periodic_noise(1, 4)))
