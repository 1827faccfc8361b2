"""What a page draws of a document: bodies, skins, joints, lines of sight and the world, as JSON.

A body is drawn in its own frame at its centre of mass, as in recordings. `frame` is the position of
the configuration's frame from there. Both are the same place for all shapes but meshes.
"""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from evo_cpg.creature.creature import NO_LIMIT, length_of, lowest_height, neutral_pose
from evo_cpg.creature.loft import outline, section_axes
from evo_cpg.io.schema.shape import LoftConfig
from evo_cpg.view.drawing_page.document import Data
from evo_cpg.view.drawing_page.lookup import Posed, posed
from evo_cpg.view.meshes import pieces
from evo_cpg.view.run_page.viewer_data import packed, piece_data, skin_data
from evo_cpg.view.scene import quaternions


def scene(data: Data, source: Path) -> dict[str, Any]:
    """Return the drawing of a document.

    Raises:
        KeyProblem: the creature is wrong.
    """
    here = posed(data, source)
    creature = here.creature
    arrays: dict[str, str] = {}

    def add(values: Any, kind: str) -> str:
        """Add an array under its digest, so that equal arrays are sent once."""
        text = packed(values, kind)
        key = hashlib.sha256(f"{kind}{text}".encode()).hexdigest()[:20]
        arrays[key] = text
        return key

    centres, rotations = map(np.asarray, neutral_pose(creature))
    turns = quaternions(rotations[None])[0]
    drawn = pieces(creature)
    named = {each.name: i for i, each in enumerate(here.copies)}
    bodies = []
    for i, body in enumerate(creature.bodies):
        index = named.get(body.whole or body.name)
        found: dict[str, Any] = {
            "name": body.name,
            "entry": None,
            "whole": body.whole,
            "parent": body.joint.parent if body.joint else body.whole,
            "place": centres[i].tolist(),
            "turn": turns[i].tolist(),
            "mass": float(body.mass),
            "half": np.asarray(body.shape.half_extents, float).tolist(),
            "mesh": piece_data(drawn[i][0], add) if body.shape.exists else None,
            "color": drawn[i][0].color,
            "eyes": [piece_data(piece, add) for piece in drawn[i][1:]],
            "joint": _joint(creature, i, centres, rotations),
        }
        if index is not None:
            frame = rotations[i].T @ (here.origins[index] - centres[i])
            # A place on a further part is in the frame of its body.
            turned = rotations[i].T @ here.rotations[index]
            copied = here.copies[index]
            found |= {
                "entry": here.config.bodies[copied.entry].name,
                "copies": sum(each.entry == copied.entry for each in here.copies),
                "frame": frame.tolist(),
                "turned": turned.T.tolist(),
                "sections": [] if body.whole else _sections(here, index, frame),
            }
        bodies.append(found)
    return {
        "bodies": bodies,
        **skin_data(creature, add),
        "sights": [
            {
                "body": eye.body,
                "place": [float(x) for x in eye.position],
                "along": [float(x) for x in eye.axis],
                "half_angle": float(eye.field_of_view) / 2,
            }
            for eye in creature.light_sensors
        ],
        "pressure": list(creature.pressure_sensors),
        "length": float(length_of(creature)),
        "lowest": float(lowest_height(creature)),
        "mass": float(creature.mass),
        "axes": sum(len(body.joint.dofs) for body in creature.bodies if body.joint),
        "arrays": arrays,
    }


def _sections(here: Posed, index: int, frame: np.ndarray) -> list[dict[str, Any]]:
    """Return the cross-sections of a body that is a loft, in the frame at its centre of mass."""
    copied = here.copies[index]
    shape = here.config.bodies[copied.entry].shape
    if not isinstance(shape, LoftConfig):
        return []
    if copied.mirror:
        shape = shape.mirrored(copied.mirror)
    sections = shape.drawn
    corners = outline(shape.corners)
    return [
        {
            "place": (frame + each.at).tolist(),
            "across": (each.width / 2 * across).tolist(),
            "up": (each.height / 2 * up).tolist(),
            "outline": corners.tolist(),
        }
        for each, (across, up) in zip(sections, section_axes(sections), strict=True)
    ]


def _joint(creature: Any, i: int, centres: Any, rotations: Any) -> dict[str, Any] | None:
    joint = creature.bodies[i].joint
    if joint is None:
        return None
    place = centres[i] + rotations[i] @ np.asarray(joint.child_anchor, float)

    def written(limit: float, unit: str) -> float | None:
        """Return a limit in degrees or in m, or None for no limit."""
        if abs(limit) >= NO_LIMIT:
            return None
        return float(np.degrees(limit)) if unit == "rad" else float(limit)

    return {
        "place": place.tolist(),
        "axes": [
            {
                "kind": dof.kind.key,
                "along": (rotations[i] @ np.asarray(dof.axis, float)).tolist(),
                "at": (place + rotations[i] @ np.asarray(dof.place, float)).tolist(),
                "lower": written(float(dof.lower), dof.kind.unit),
                "upper": written(float(dof.upper), dof.kind.unit),
            }
            for dof in joint.dofs
        ],
    }
