"""An off-screen picture: the plotter's settings, its pixels, and kinds of actors."""

import contextlib
from collections.abc import Iterator
from typing import Any, cast

import numpy as np
import pyvista as pv
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkInformation, vtkUnsignedCharArray
from vtkmodules.vtkRenderingCore import vtkRenderWindow
from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLActor


@contextlib.contextmanager
def canvas(size: tuple[int, int]) -> Iterator[pv.Plotter]:
    """Open a plotter that needs no display.

    Args:
        size: width and height, pixels.
    """
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


def pixels(plotter: pv.Plotter) -> np.ndarray:
    """Return the picture just rendered, ``(height, width, 3)`` bytes, bottom row first."""
    width, height = plotter.window_size
    buffer = vtkUnsignedCharArray()
    window = cast(vtkRenderWindow, plotter.render_window)
    window.GetPixelData(0, 0, width - 1, height - 1, 0, buffer, 0)
    return vtk_to_numpy(buffer).reshape(height, width, 3)


def add_faded(plotter: pv.Plotter, mesh: pv.PolyData, rgba: np.ndarray, **given: Any) -> pv.Actor:
    """Draw a mesh unlit, in the colours and opacities of its points.

    Args:
        plotter: plotter of the picture.
        mesh: mesh that receives the colours as its array ``rgba``.
        rgba: colours and opacities, bytes ``(points, 4)``.
        given: further arguments of `pyvista.Plotter.add_mesh`.
    """
    mesh.point_data["rgba"] = rgba
    actor = plotter.add_mesh(mesh, scalars="rgba", rgba=True, lighting=False, **given)
    actor.ForceTranslucentOn()
    return actor


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
