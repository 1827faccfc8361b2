"""Draw a scene: build it once, then move its parts from frame to frame.

Each `add_...` function puts actors into the plotter. If they change from frame to frame, it returns
a function that moves them or overwrites arrays in place. Nothing is meshed again.
"""

from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
import pyvista as pv
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkUnsignedCharArray
from vtkmodules.vtkRenderingCore import vtkRenderWindow

from evo_cpg.view.flow import add_flow
from evo_cpg.view.ghosts import add_ghosts
from evo_cpg.view.ground import add_ground, add_numbers
from evo_cpg.view.meshes import surfaces
from evo_cpg.view.offscreen import placed
from evo_cpg.view.scene import moved_aside
from evo_cpg.view.scenery import (
    add_goal_light,
    add_lane_lights,
    add_particles,
    add_shafts,
    add_sky,
    add_track,
    add_trail,
)
from evo_cpg.view.shadows import add_contacts, add_shadows, add_sun_shadows
from evo_cpg.view.skin import add_skins
from evo_cpg.view.stage import Stage, Update
from evo_cpg.view.terrain import Terrain, add_obstacles, obstacle_mesh
from evo_cpg.view.wall import add_wall
from evo_cpg.view.water import add_ceiling, add_mirror, add_tint, add_waterlines


def set_scene(
    stage: Stage, bodies: Sequence[Sequence[pv.Actor]], skins: bool = True
) -> Callable[[int], np.ndarray]:
    """Build everything around the animal.

    Args:
        stage: the scene and its camera.
        bodies: actors of each body, as `evo_cpg.view.meshes.add_bodies` returns them. A wall has
            none.
        skins: whether chains have a skin.

    Returns:
        A function that draws a frame by its number: bytes ``(height, width, 3)``, bottom row first.
    """
    plotter = stage.plotter
    updates = add_wall(stage) if stage.scene.wall is not None else _add_world(stage, skins)
    plotter.camera.view_angle = stage.camera.view_angle
    plotter.camera.up = (0.0, 0.0, 1.0)
    # This makes the window without drawing. Without a window VTK resets the camera later.
    plotter.renderer.SetDraw(False)
    plotter.show(auto_close=False, interactive=False)
    plotter.renderer.SetDraw(True)

    def show(number: int) -> np.ndarray:
        shot = stage.shot(number)
        plotter.camera.position = shot.eye
        plotter.camera.focal_point = shot.focus
        away = float(np.linalg.norm(shot.focus - shot.eye))
        plotter.camera.clipping_range = (0.05 * away, 20 * stage.away)
        for update in updates:
            update(shot)
        for actors, place, turn in zip(bodies, shot.position, shot.rotation, strict=bool(bodies)):
            for actor in actors:
                actor.user_matrix = placed(turn, place)
        plotter.render()
        width, height = plotter.window_size
        buffer = vtkUnsignedCharArray()
        window = cast(vtkRenderWindow, plotter.render_window)
        window.GetPixelData(0, 0, width - 1, height - 1, 0, buffer, 0)
        return vtk_to_numpy(buffer).reshape(height, width, 3)

    return show


def _add_world(stage: Stage, skins: bool) -> list[Update]:
    """Draw everything around the only animal, and the skins of its chains."""
    plotter, scene, look = stage.plotter, stage.scene, stage.look
    # Translucent actors are drawn in the order in which they are added. So the floor comes first,
    # then things in its plane. The light and the trail come after the shadows, the water last.
    updates = [add_sky(stage), add_ground(stage)]
    if stage.measured and scene.numbers:
        updates.append(add_numbers(stage))
    staging = scene.staging
    if staging is not None and staging.track is not None:
        add_track(stage, staging.track)
    if stones := scene.ground.obstacles:
        add_obstacles(plotter, stones, look.ambient, stage.ground.height)
        shades = [obstacle_mesh(stone, shade=True) for stone in stones]
        meshes, places, turns = zip(*shades, strict=True)
        half_extents = np.array([np.ptp(np.asarray(mesh.points), axis=0) / 2 for mesh in meshes])
        still = stage.shot(0)._replace(position=np.array(places), rotation=np.array(turns))
        # The shadows of stones rest.
        add_shadows(stage, half_extents)(still)
        add_sun_shadows(stage, meshes)(still)
    updates += [
        add_sun_shadows(stage, surfaces(scene.creature)),
        add_shadows(stage, scene.half_extents),
    ]
    if scene.stands:
        updates.append(add_contacts(stage))
    if scene.ghosts is not None:
        updates.append(add_ghosts(stage))
    if scene.goal is not None:
        updates.append(add_goal_light(stage, scene.goal))
        if staging is not None and staging.lanes.any():
            goals = np.repeat(scene.goal[:, None], len(staging.lanes), 1)
            if scene.ghosts is not None and scene.ghosts.light is not None:
                goals = scene.ghosts.light
            lanes = staging.lanes, scene.ground, scene.radius
            goals = moved_aside(goals[:, :, None], *lanes)[:, :, 0]
            updates.append(add_lane_lights(stage, goals))
    # In a race, trails would cross the lines.
    if staging is None:
        updates.append(add_trail(stage))
    if look.particles:
        if scene.flow is None:
            add_particles(stage)
        else:
            updates.append(add_flow(stage, scene.flow))
        if look.under_water:
            add_shafts(stage)
    if scene.surface is not None and look.under_water:
        updates.append(add_ceiling(stage, scene.surface))
    elif scene.surface is not None and isinstance(stage.ground, Terrain):
        updates.append(add_tint(stage, stage.ground, scene.surface))
        updates.append(add_mirror(stage, scene.surface))
        updates.append(add_waterlines(stage, scene.surface))
    if skins:
        updates.append(add_skins(stage))
    return updates
