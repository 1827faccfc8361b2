"""The looks of the worlds: colours, light and proportions of sea and land."""

import dataclasses

import numpy as np
from jaxtyping import Float

from evo_cpg.view.camera import level_axes

# The sun in a sky stands to the left of the viewer and behind the viewer. It lights the visible
# sides, and shadows fall to the right, ahead and up in the picture.
_SUN_SEEN = (-0.62, -0.45, 1.0)
_SUN_AT_SEA = (-0.4, -0.6, 1.6)


@dataclasses.dataclass(frozen=True)
class Look:
    """Colours and proportions of a world. Lengths are relative to the animal's radius.

    Attributes:
        distance: colour of the background, into which the floor fades.
        floor: tints of the floor, from dark to light.
        grid: colour of the grid lines.
        shadow: colour of shadows.
        shadow_strength: opacity of the soft patches under the bodies, 0 to 1.
        cast_strength: opacity of the shadows that the sun casts, 0 to 1. 0 means no shadows.
        sun: colour of the directional light.
        fill: colour of the weak light from the viewer's side.
        ambient: fraction of light that comes from everywhere.
        trail: colour of the trail.
        light: colour of the glowing sphere at the goal.
        halo: colour of the glow around that sphere.
        glow: opacity of the glow and of the pool of light on the floor, 0 to 1.
        text: colour of the captions.
        ghost: colour of the other animals of a crowd.
        visibility: distance at which the floor has faded to a third.
        elevation: elevation of the camera above the focus, rad, when it looks towards a light.
        side_elevation: the same when it looks at the animal's side, rad. On land it is low enough
            to show the horizon and the space under the animal.
        particles: whether specks drift in the medium.
        checkered: whether alternate grid cells differ in tone.
        zenith: colour towards which the sky, or the water, turns above the horizon.
        under_water: whether the viewer is in the water, which is lit from above.
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
    ghost: str
    visibility: float
    elevation: float
    side_elevation: float
    particles: bool
    checkered: bool
    zenith: str
    under_water: bool = False


STYLES = {
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
        ghost="#bfeef5",
        visibility=5.5,
        elevation=np.radians(12),
        side_elevation=np.radians(12),
        particles=True,
        checkered=False,
        zenith="#62d2dc",
        under_water=True,
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
        ghost="#5c7590",
        visibility=16.0,
        elevation=np.radians(18),
        side_elevation=np.radians(11),
        particles=False,
        checkered=True,
        zenith="#7fb0dc",
    ),
}

# Look of water whose surface is seen from above.
SHORE = dataclasses.replace(
    STYLES["land"],
    distance="#dfebf1",
    floor=("#bfa77a", "#eedcb1"),
    grid="#7d6b4a",
    zenith="#6ea8dc",
    elevation=np.radians(20),
    side_elevation=np.radians(15),
    particles=True,
)


def sun_direction(look: Look, sight: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return the unit vector towards the sun, for a direction of view in the first frame."""
    towards = np.array(_SUN_AT_SEA)
    if not look.under_water:
        towards = np.array(_SUN_SEEN) @ np.stack([*level_axes(sight), [0.0, 0.0, 1.0]])
    return towards / np.linalg.norm(towards)
