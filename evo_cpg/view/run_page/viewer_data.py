"""Data of a page's viewer: meshes, places and colours, as JSON.

Arrays are base64 of little-endian numbers. Equal arrays, such as the triangles of all boxes, are
written once.
"""

import base64
from typing import Any, cast

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature
from evo_cpg.physics.contact.terrain import Part
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.camera import smooth
from evo_cpg.view.meshes import BodySurface, head_index, pieces
from evo_cpg.view.run_page.animal_data import crowd_data, piece_data, skin_data
from evo_cpg.view.scene import Clip, Panel, Scene, quaternions, sample, scene_of
from evo_cpg.view.terrain import obstacle_mesh

# Frames per second. The viewer interpolates between them.
RATE = 30.0
# Window over which the path of the camera's focus is smoothed, s.
_CALM = 1.0
# The mesh of uneven ground ends this many radii of the animal beyond its path and the light.
_FAR = 14.0
# Range of a signed number of 16 bits.
_SHORT = 32767
# Number of corners to which finer meshes of stones are reduced.
_FINE = 1500
_STONE = "#999188"
# Fields of a look that the viewer uses.
_LOOK = (
    "distance", "floor", "grid", "sun", "fill", "trail", "light", "halo", "zenith", "checkered",
    "text", "particles",
)  # fmt: skip


class Arrays:
    """Base64 texts of arrays. Equal arrays share a text and its number.

    Attributes:
        written: the texts.
    """

    def __init__(self) -> None:
        self.written: list[str] = []
        self._numbers: dict[bytes, int] = {}

    def add(self, values: Any, kind: str) -> int:
        """Add an array of a kind, such as ``<f4``, and return its number."""
        data = np.ascontiguousarray(values, kind).tobytes()
        if data not in self._numbers:
            self._numbers[data] = len(self.written)
            self.written.append(base64.b64encode(data).decode())
        return self._numbers[data]


def viewer_data(panel: Panel) -> dict[str, Any]:
    """Return all moving and fixed things in the scene of an animal."""
    clip = sample(panel.recording, RATE)
    # The crowd has instants of its own.
    scene, arrays = scene_of(panel._replace(crowd=None), clip), Arrays()
    level, head = scene.level, head_index(scene.creature)
    return {
        "start": float(clip.time[0]),
        **animal_data(scene.creature, arrays),
        **_motion(clip, arrays),
        "head": head,
        "speed": arrays.add(clip.speed, "<f4"),
        "distance": arrays.add(clip.distance, "<f4"),
        "measured": scene.measured,
        "radius": scene.radius,
        "bearing": scene.bearing,
        "floor": float(clip.position[..., 2].min()) if level is None else level,
        "spacing": scene.grid,
        "terrain": None if level is not None else _terrain(scene, arrays),
        "obstacles": [_obstacle(obstacle, arrays) for obstacle in scene.ground.obstacles],
        "goal": None if scene.goal is None else [float(x) for x in scene.goal],
        "surface": None if scene.surface is None else float(scene.surface),
        "water": panel.world == "water" and scene.surface is None,
        "crowd": None
        if panel.crowd is None
        else crowd_data(panel.creature, panel.crowd, scene.look, arrays.add),
        "look": {name: getattr(scene.look, name) for name in _LOOK},
        # Last, because the entries above add arrays.
        "arrays": arrays.written,
    }


def animal_data(creature: Creature, arrays: Arrays) -> dict[str, Any]:
    """Return the surfaces of an animal."""
    bodies = [
        {"name": body.name, "parts": [piece_data(piece, arrays.add) for piece in own]}
        for body, own in zip(creature.bodies, pieces(creature), strict=True)
    ]
    return {"bodies": bodies, **skin_data(creature, arrays.add)}


def motion_data(recording: Recording, rate: float, seconds: float) -> dict[str, Any]:
    """Return the motion of an animal without its scene.

    Args:
        recording: the motion.
        rate: frames per second.
        seconds: length from the start, s.
    """
    arrays = Arrays()
    made = _motion(sample(recording, rate, seconds=seconds), arrays)
    return made | {"arrays": arrays.written}


def _motion(clip: Clip, arrays: Arrays) -> dict[str, Any]:
    return {
        "rate": clip.rate,
        "count": len(clip.time),
        "position": arrays.add(clip.position, "<f4"),
        "rotation": arrays.add(quaternions(clip.rotation) * _SHORT, "<i2"),
        "focus": arrays.add(smooth(clip.position.mean(1), _CALM * clip.rate), "<f4"),
    }


def _terrain(scene: Scene, arrays: Arrays) -> dict[str, int]:
    terrain = scene.terrain(_FAR * scene.radius)
    made = {name: arrays.add(values, "<f4") for name, values in terrain._asdict().items()}
    return made | {"normals": arrays.add(terrain.normals() * 127, "i1")}


def _obstacle(obstacle: Part, arrays: Arrays) -> dict[str, Any]:
    mesh, place, turn = obstacle_mesh(obstacle)
    coarse = mesh.triangulate()
    if coarse.n_points > _FINE:
        coarse = coarse.decimate(1 - _FINE / coarse.n_points)
    turned = quaternions(turn[None])[0].tolist()
    made = piece_data(BodySurface(cast(pv.PolyData, coarse), _STONE), arrays.add)
    return made | {"place": place.tolist(), "turn": turned}
