"""An animal and its world over the instants of a clip, as films, pages and glTF files show them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.creature import Body, Creature
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Plane
from evo_cpg.physics.water.water import Water
from evo_cpg.simulation.recording import Recording, RecordingError
from evo_cpg.training.crowd import CrowdMotion
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.view.camera import course
from evo_cpg.view.look import SHORE, STYLES, Look
from evo_cpg.view.offscreen import CELLS
from evo_cpg.view.signals import Signals
from evo_cpg.view.terrain import Terrain, heights, make_terrain

# Window of the displayed speed, s: long enough to average a tail beat.
_SPEED_WINDOW = 1.0


class Clip(NamedTuple):
    """A recording sampled at the film's frames.

    Attributes:
        time: time of each frame, s.
        position: centre of every body, m.
        rotation: rotation from body to world.
        distance: distance from the root to the goal or, without a goal, horizontal distance of the
            root from its start, m.
        light: place of the light, m, or NaN without a light.
        speed: speed of the mean of the bodies' centres, averaged over the last second, m/s.
        rate: frames per second of recorded time.
    """

    time: Float[np.ndarray, " frames"]
    position: Float[np.ndarray, "frames b 3"]
    rotation: Float[np.ndarray, "frames b 3 3"]
    distance: Float[np.ndarray, " frames"]
    light: Float[np.ndarray, "frames 3"]
    speed: Float[np.ndarray, " frames"]
    rate: float


def sample(
    recording: Recording, fps: float, speed: float = 1.0, seconds: float | None = None
) -> Clip:
    """Sample a recording at the frames of a film, with interpolation between steps.

    Args:
        recording: the motion.
        fps: frames per second of the film.
        speed: recorded seconds per second of film.
        seconds: recorded time to show, s, or None for all of it.
    """
    start, end = recording.time[0], recording.time[-1]
    if seconds is not None:
        end = min(end, start + seconds)
    # A hundredth of a frame keeps rounding from dropping the last frame.
    time = start + np.arange(int((end - start) * fps / speed + 1.01)) * (speed / fps)
    return sample_at(recording, time, fps / speed)


def sample_at(recording: Recording, time: Float[np.ndarray, " frames"], rate: float) -> Clip:
    """Sample a recording at some instants (s) with a rate (1/s), interpolating between steps."""
    after = np.clip(np.searchsorted(recording.time, time), 1, max(len(recording.time) - 1, 1))
    after = np.minimum(after, len(recording.time) - 1)
    before = np.maximum(after - 1, 0)
    step = recording.time[after] - recording.time[before]
    weight = np.clip((time - recording.time[before]) / np.where(step > 0, step, 1), 0, 1)

    # Nothing is between two places of a light that jumps.
    jumps = np.isin(after, recording.appearances)
    whole = np.where(jumps, weight.round(), weight)

    def between(values: np.ndarray, weight: np.ndarray = weight) -> np.ndarray:
        part = weight.reshape(-1, *(1,) * (values.ndim - 1))
        return (1 - part) * values[before] + part * values[after]

    # The nearest rotation to a mean of two near rotations: its polar factor.
    left, _, right = np.linalg.svd(between(recording.rotation))
    position, frames = between(recording.position), np.arange(len(time))
    # In the first second the speed is the mean since the start, so the first frame shows no speed.
    first = np.maximum(frames - max(round(_SPEED_WINDOW * rate), 1), 0)
    moved = np.linalg.norm((position - position[first]).mean(1), axis=-1)
    speed = moved * rate / np.maximum(frames - first, 1)
    distance, light = between(recording.distance, whole), between(recording.light, whole)
    return Clip(time, position, left @ right, distance, light, speed, rate)


def quaternions(rotation: Float[np.ndarray, "t *b 3 3"]) -> Float[np.ndarray, "t *b 4"]:
    """Return unit quaternions x, y, z, w of rotation matrices.

    Signs are chosen so that no quaternion jumps to its negative from one instant to the next.
    """
    # SciPy takes long to import.
    from scipy.spatial.transform import Rotation

    found = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat()
    found = found.reshape(*rotation.shape[:-2], 4)
    flips = np.where((found[1:] * found[:-1]).sum(-1) < 0, -1.0, 1.0)
    found[1:] *= np.cumprod(flips, axis=0)[..., None]
    return found


# The floor lies this many radii of the animal below the lowest point of its path through water.
_FLOOR_DEPTH = 0.55
# An animal walks if its lowest body is at most this many radii above the ground.
_WALKS = 0.25
# The surface is shown if land within this many radii of the path rises out of the water.
_NEARBY = 4.0


class Exhibit(NamedTuple):
    """An animal on a wall.

    Attributes:
        creature: the animal, in the colour of its line of descent.
        recording: motion of the animal.
        color: colour of the line, as ``#rrggbb``.
        number: place of the individual in its population.
        fitness: fitness of the individual.
        founder: number of its ancestor in generation 0, or None if unknown.
    """

    creature: Creature
    recording: Recording
    color: str
    number: int
    fitness: float
    founder: int | None = None


class Growth(NamedTuple):
    """Sizes and colours of bodies that grow, at the instants of a recording.

    Attributes:
        scale: size of each body along its axes, relative to that of the creature.
        fresh: part of the colour of new parts in that of each body, 0 to 1.
        begins: instants at which the body begins to change, and 0 for the first body, s.
        words: words for each body.
    """

    scale: Float[np.ndarray, "t b 3"]
    fresh: Float[np.ndarray, "t b"]
    begins: tuple[float, ...]
    words: tuple[str, ...] = ()


class Panel(NamedTuple):
    """An animal that a film shows.

    Attributes:
        creature: the animal.
        recording: motion of the animal.
        title: caption, or None for the creature's name.
        world: medium, ``water`` or ``land``.
        ground: ground that carries the animal, or None without ground.
        surface: height of the water's surface, m, or None without a surface.
        signals: signals in a strip below the animal, or None for no strip.
        note: text below the title, in small letters.
        crowd: other animals of the same kind, which are drawn as ghosts, or None.
        numbers: whether distances are painted on the ground.
        staging: arrangement of a race, or None.
        exhibits: animals on a wall, the fittest first, instead of the only animal. None if empty.
        growth: growth of the animal's bodies, or None for an animal that keeps its shape.
        flow: flowing water, or None if the water rests.
    """

    creature: Creature
    recording: Recording
    title: str | None = None
    world: str = "water"
    ground: Ground | None = None
    surface: float | None = None
    signals: Signals | None = None
    note: str = ""
    crowd: CrowdMotion | None = None
    numbers: bool = True
    staging: "Staging | None" = None
    exhibits: tuple[Exhibit, ...] = ()
    growth: Growth | None = None
    flow: Water | None = None


class Track(NamedTuple):
    """Straight lanes side by side, with lines across them.

    Attributes:
        start: start in the nearest lane, m.
        bearing: direction of the lanes from the x axis, rad.
        spacing: distance between the lines, m.
        lines: number of lines beyond the start.
        right: distance of the right border from the start, m.
        left: distance of the left border from the start, m.
        finish: distance of a finish from the start, m, or None.
    """

    start: Float[np.ndarray, "3"]
    bearing: float
    spacing: float
    lines: int
    right: float
    left: float
    finish: float | None = None

    def at(self, along: float, aside: float) -> Float[np.ndarray, "3"]:
        """Return a place by its distances along the lanes and to their left, m."""
        c, s = np.cos(self.bearing), np.sin(self.bearing)
        return self.start + np.array([along * c - aside * s, along * s + aside * c, 0.0])


class Staging(NamedTuple):
    """Arrangement of a race: animals in lanes, on a floor with lines.

    Attributes:
        lanes: displacement of each other animal from its own place, m.
        track: lines on the floor, or None.
        floor: height of the floor under swimmers, m, or None for the usual one.
        names: words above the animal and each other one, or none.
        under: whether the camera is below the surface of the water.
    """

    lanes: Float[np.ndarray, "n 3"] = np.zeros((0, 3))
    track: Track | None = None
    floor: float | None = None
    names: tuple[str, ...] = ()
    under: bool = False


def panel_of(
    experiment: ExperimentParts,
    recording: Recording,
    title: str,
    signals: Signals | None = None,
    note: str = "",
) -> Panel:
    """Return a panel with a recording and the world of its experiment."""
    world = experiment.simulation.world
    return Panel(
        experiment.creature,
        recording,
        title,
        world="land" if world.water is None else "water",
        ground=world.ground,
        surface=None if world.water is None else world.water.surface,
        signals=signals,
        note=note,
        flow=world.water if world.water and world.water.flows else None,
    )


def check_panel(panel: Panel) -> None:
    """Check that an animal can be shown.

    Raises:
        RecordingError: the recording does not fit its creature, is empty or is not finite.
        ValueError: the world is unknown, or the surface has no finite height.
    """
    if panel.surface is not None and not np.isfinite(panel.surface):
        raise ValueError(
            f"surface is {panel.surface:g}, but must be finite, or None without a surface"
        )
    if panel.world not in STYLES:
        raise ValueError(f"world is {panel.world!r}. Allowed: {', '.join(STYLES)}")
    recording, bodies = panel.recording, len(panel.creature.bodies)
    if not len(recording.time):
        raise RecordingError("the recording is empty: it holds no instant")
    if recording.position.shape[1] != bodies:
        raise RecordingError(
            f"the recording has {recording.position.shape[1]} bodies, "
            f"but {panel.creature.name!r} has {bodies}"
        )
    finite = np.isfinite(recording.position).all((1, 2))
    finite &= np.isfinite(recording.rotation).all((1, 2, 3))
    if not finite.all():
        raise RecordingError(
            f"the recording diverges at {recording.time[finite.argmin()]:g} s: "
            "from then on positions or rotations are not finite"
        )


class Marks(NamedTuple):
    """Pattern of the ground, which makes the animal's path readable.

    Attributes:
        origin: origin of the pattern and its numbers ``(2,)``, m.
        course: bearing of the numbers from the x axis, rad.
        spacing: distance between the numbers, which is the side of a tile, m.
    """

    origin: np.ndarray
    course: float
    spacing: float

    def turn(self) -> np.ndarray:
        """Return the rotation from the pattern's axes to the world's ``(2, 2)``."""
        c, s = np.cos(self.course), np.sin(self.course)
        return np.array([[c, -s], [s, c]])

    def tiles(self, place: np.ndarray) -> np.ndarray:
        """Return texture coordinates of the floor at places x and y ``(n, 2)``, m."""
        return (place - self.origin) @ self.turn() / self.spacing


class Wall(NamedTuple):
    """Animals in the cells of a grid: upright in water, and on the ground on land.

    Attributes:
        creatures: the animals.
        middles: middle of each cell, m.
        cell: width of a cell and distance of the rows, m.
        drift: horizontal path of each animal, to the right and away from the viewer, m. The drawn
            animals stay in their cells.
    """

    creatures: tuple[Creature, ...]
    middles: Float[np.ndarray, "n 3"]
    cell: Float[np.ndarray, "2"]
    drift: Float[np.ndarray, "frames n 2"]


class Scene(NamedTuple):
    """An animal in its world, over the instants of a clip.

    Attributes:
        creature: the animal.
        clip: motion of the animal. On a wall it has the bodies of all animals.
        goal: place of the light ``(frames, 3)``, m, or None without a light.
        ground: ground that carries the animal, or a level floor below its path.
        stands: whether the ground carries the animal.
        surface: height of the water's surface, m, or None if no surface is seen.
        look: look of the world.
        radius: distance of the animal's far ends from its middle at the start, m.
        bearing: bearing of the path from the x axis, rad.
        marks: pattern of the ground.
        ghosts: other animals of the same kind at the clip's instants, or None.
        numbers: whether distances are painted on the ground.
        staging: arrangement of a race, or None.
        wall: animals on a wall instead of the only animal, or None.
        flow: flowing water, or None if the water rests.
    """

    creature: Creature
    clip: Clip
    goal: np.ndarray | None
    ground: Ground
    stands: bool
    surface: float | None
    look: Look
    radius: float
    bearing: float
    marks: Marks
    ghosts: CrowdMotion | None = None
    numbers: bool = True
    staging: Staging | None = None
    wall: Wall | None = None
    flow: Water | None = None

    @property
    def bodies(self) -> list[Body]:
        """Bodies of the animal, or of all animals on a wall."""
        shown = (self.creature,) if self.wall is None else self.wall.creatures
        return [body for creature in shown for body in creature.bodies]

    @property
    def level(self) -> float | None:
        """Height of level ground, m. None if it is uneven, has obstacles, or water is on view."""
        level = self.ground.level
        return None if self.surface is not None or level is None else float(level)

    @property
    def measured(self) -> str:
        """Meaning of the clip's distance, in words."""
        return "from the start" if self.goal is None else "to the light"

    @property
    def half_extents(self) -> np.ndarray:
        """Half extents of the bodies ``(b, 3)``, m."""
        return np.array([body.shape.half_extents for body in self.bodies])

    def terrain(self, far: float) -> Terrain:
        """Return a mesh of the ground that ends ``far`` (m) beyond the path and the light."""
        filmed = self.clip.position.reshape(-1, 3)
        if self.goal is not None:
            filmed = np.concatenate([filmed, self.goal])
        return make_terrain(self.ground.floor, filmed[:, :2], self.radius, far)


def scene_of(panel: Panel, clip: Clip) -> Scene:
    """Return the scene that shows an animal over a clip of its recording."""
    creature, surface, stands = panel.creature, panel.surface, panel.ground is not None
    goal = clip.light if np.isfinite(clip.light).all() else None
    radius = animal_radius(creature, clip)
    if surface is not None and surface_is_seen(creature, clip, panel.ground, surface):
        look = SHORE
        if panel.staging is not None and panel.staging.under:
            look = STYLES["water"]
    else:
        look, surface = STYLES[panel.world], None
    # Without a light, the recorded distance refers to the root.
    root = clip.position[:, creature.root_index]
    bearing = course(root, panel.recording.goal, radius / 10)
    if panel.ground is not None:
        ground, marks = panel.ground, Marks(root[0, :2], bearing, mark_spacing(2 * radius))
    else:
        lowest = clip.position[..., 2].min() - max(body.shape.reach for body in creature.bodies)
        lowest = lowest if goal is None else min(lowest, goal[:, 2].min())
        lowest -= _FLOOR_DEPTH * radius
        if panel.staging is not None and panel.staging.floor is not None:
            lowest = panel.staging.floor
        ground = Ground(floor=Plane(height=float(lowest)))
        marks = Marks(np.zeros(2), 0.0, CELLS * grid_spacing(2 * radius))
    staging, ghosts = panel.staging, panel.crowd
    if ghosts is not None:
        # The nearest known instants.
        near = np.searchsorted((ghosts.time[1:] + ghosts.time[:-1]) / 2, clip.time)
        place, turn = ghosts.position[near], ghosts.rotation[near]
        if staging is not None:
            place = moved_aside(place, staging.lanes, ground, radius)
        light = None if ghosts.light is None else ghosts.light[near]
        ghosts = CrowdMotion(clip.time, place, turn, ghosts.goal, light)
    world = goal, ground, stands, surface, look
    seen = radius, bearing, marks, ghosts, panel.numbers, staging
    return Scene(creature, clip, *world, *seen, flow=panel.flow)


def moved_aside(
    place: Float[np.ndarray, "*t n b 3"],
    lanes: Float[np.ndarray, "n 3"],
    ground: Ground,
    radius: float,
) -> Float[np.ndarray, "*t n b 3"]:
    """Return places of bodies in the lanes of their animals, m. Walkers follow the ground there.

    Args:
        place: places of the bodies of each animal, m.
        lanes: displacement of each animal, m.
        ground: ground under the animals.
        radius: radius of an animal, m.
    """
    moved = place + lanes[:, None]
    if ground.level is not None:
        return moved
    here, there = (heights(ground.floor, each[..., :2]) for each in (place, moved))
    rise, gap = (there - here).mean(-1), (place[..., 2] - here).min(-1)
    # A swimmer keeps its height, but not within the ground.
    walks = np.interp(gap / radius, (_WALKS, 2 * _WALKS), (1.0, 0.0))
    moved[..., 2] += np.maximum(walks * rise, rise - gap / 2)[..., None]
    return moved


def surface_is_seen(creature: Creature, clip: Clip, ground: Ground | None, surface: float) -> bool:
    """Return whether the animal, or land near its path, rises out of the water."""
    for i, body in enumerate(creature.bodies):
        # The world's up direction in the body's frame.
        ups = clip.rotation[:, i, 2]
        tops = [body.shape.support(up) @ up for up in ups]
        if (clip.position[:, i, 2] + tops).max() > surface:
            return True
    if ground is None:
        return False
    near = _NEARBY * animal_radius(creature, clip)
    path = clip.position.reshape(-1, 3)[:, :2]
    return bool(make_terrain(ground.floor, path, near / 4, near).z.max() > surface)


def animal_radius(creature: Creature, clip: Clip) -> float:
    """Return the distance of the animal's far ends from its middle at the start, m."""
    start, reach = clip.position[0], max(body.shape.reach for body in creature.bodies)
    return float(np.linalg.norm(start - start.mean(0), axis=-1).max()) + reach


def grid_spacing(length: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is at most half a length, m."""
    power = 10.0 ** np.floor(np.log10(length / 2))
    return float(power * max(step for step in (1, 2, 5) if step * power <= length / 2 * 1.001))


def mark_spacing(length: float) -> float:
    """Return the distance between the numbers on the ground, about the animal's length (m)."""
    return grid_spacing(2.4 * length)
