"""The ground and its obstacles, in MJCF.

Planes, boulders and blocks are one geom each and exact. A shore is three slabs, of which the outer
two are finite. A relief is a height field. MuJoCo halves its cells into triangles, and ours are
bilinear. MuJoCo's field ends at its edges, and ours continues level.
"""

from collections.abc import Mapping
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Block, Boulder, GroundPart, Plane, Relief, Shore

# Reach of slabs, and thickness of slabs and height fields, m. An animal walks less in a trial, and
# sinks less in a step.
_FAR, _THICK = 100.0, 1.0

# Decimal places of coordinates (m) and directions.
_PLACES = 15


def number_text(*values: float) -> str:
    """Return numbers as the shortest text that reads back exactly."""
    # Adding 0 removes a negative zero.
    return " ".join(np.format_float_positional(float(v) + 0.0, trim="-") for v in values)


def set_effects(element: Element, values: Mapping[str, float]) -> None:
    """Set attributes of an element, except those that are 0 and have no effect."""
    for key, value in values.items():
        if value:
            element.set(key, number_text(value))


def place_text(values: np.ndarray) -> str:
    """Return coordinates without the digits that sines and cosines leave of a zero."""
    return number_text(*np.round(values, _PLACES))


def add_ground(root: Element, place: Element, ground: Ground, taken: list[str]) -> list[str]:
    """Add the floor and the obstacles.

    Args:
        root: the ``mujoco`` element.
        place: the ``worldbody`` element.
        ground: ground to add.
        taken: names of the creature's geoms.

    Returns:
        The names of the geoms.

    Raises:
        ExchangeError: MJCF cannot hold a part.
    """
    parts = {"ground": ground.floor}
    parts |= {f"obstacle{i + 1}": part for i, part in enumerate(ground.obstacles)}
    names = []
    for name, part in parts.items():
        solids = _solids(root, name, part)
        for i, solid in enumerate(solids):
            unique = f"{name}.{i + 1}" if len(solids) > 1 else name
            while unique in taken:
                unique += "_"
            geom = SubElement(place, "geom", {"name": unique, **solid})
            geom.set("friction", number_text(ground.dynamic_friction))
            names.append(unique)
    return names


def _solids(root: Element, name: str, part: GroundPart) -> list[dict[str, str]]:
    """Return the attributes of the geoms that make up a part."""
    if isinstance(part, Plane):
        normal = np.array(part.normal) / np.linalg.norm(part.normal)
        return [
            {
                "type": "plane",
                "size": number_text(0.0, 0.0, 1.0),
                "pos": place_text(part.height * normal),
                "zaxis": place_text(normal),
            }
        ]
    if isinstance(part, Boulder):
        ball = {"type": "sphere", "size": number_text(part.radius)}
        return [ball | {"pos": number_text(*part.centre)}]
    if isinstance(part, Block):
        box = {"type": "box", "size": number_text(*part.half_extents)}
        turn = number_text(0.0, 0.0, part.heading)
        return [box | {"pos": number_text(*part.centre), "euler": turn}]
    if isinstance(part, Shore):
        return _shore(part)
    if isinstance(part, Relief):
        return [_relief(root, name, part)]
    raise ExchangeError(
        f"ground with a {type(part).__name__} cannot be written as MJCF. "
        "Allowed: Plane, Boulder, Block, Shore, Relief"
    )


def _shore(part: Shore) -> list[dict[str, str]]:
    """Return slabs whose upper faces meet at the beginning and end of the slope."""
    first = np.array([part.start, part.start_height])
    last = np.array([part.stop, part.stop_height])
    out = np.array([_FAR, 0.0])
    slabs = []
    for begin, end in ((first - out, first), (first, last), (last, last + out)):
        length = float(np.linalg.norm(end - begin))
        along, up = (end - begin) / length
        middle = (begin + end) / 2 - _THICK / 2 * np.array([-up, along])
        across = part.axis == "y"
        size = (_FAR, length / 2) if across else (length / 2, _FAR)
        centre = (0.0, middle[0]) if across else (middle[0], 0.0)
        axes = (1, 0, 0, 0, along, up) if across else (along, 0, up, 0, 1, 0)
        slabs.append(
            {
                "type": "box",
                "size": number_text(*size, _THICK / 2),
                "pos": place_text(np.array([*centre, middle[1]])),
                "xyaxes": place_text(np.array(axes, float)),
            }
        )
    return slabs


def _relief(root: Element, name: str, part: Relief) -> dict[str, str]:
    """Add a height field with its heights as an asset, and return attributes of its geom."""
    heights = np.asarray(part.heights, float)
    lowest, rise = float(heights.min()), float(np.ptp(heights))
    half = part.spacing * (np.array(heights.shape) - 1) / 2
    asset = root.find("asset")
    if asset is None:
        asset = Element("asset")
        # The asset follows compiler, option and default.
        root.insert(3, asset)
    field = SubElement(asset, "hfield", name=name)
    field.set("ncol", str(heights.shape[0]))
    field.set("nrow", str(heights.shape[1]))
    # MuJoCo scales heights to 0 to 1, and has the last row first, as on a map.
    field.set("size", number_text(*half, rise or 1.0, _THICK))
    field.set("elevation", number_text(*(heights.T[::-1] - lowest).ravel()))
    middle = np.array(part.corner) + half
    return {"type": "hfield", "hfield": name, "pos": number_text(*middle, lowest)}
