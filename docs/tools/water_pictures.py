"""Draw the pictures of the page on water: each law of the package beside measurements or theory.

    python docs/tools/water_pictures.py            writes docs/images/water_*.png, in a minute
    python docs/tools/water_pictures.py lift       writes one of them

Curves and open symbols are computed by the package. Filled symbols are measured. The tests hold the
tolerances and make the same animals, so their helpers are used here.
"""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), *(str(ROOT / "tests" / part) for part in ("", "physics", "creature"))]

import test_lift  # noqa: E402
import test_outline  # noqa: E402
import test_reactive_thrust as thrust  # noqa: E402
import test_viscous_drag as viscous  # noqa: E402

import measured_water as measured  # noqa: E402
from creatures import box_chain  # noqa: E402
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Shape, Sphere  # noqa: E402
from evo_cpg.view.figure import BLUE, GREEN, GREY, RED, framed, new_figure, save_figure  # noqa: E402

IMAGES = ROOT / "docs" / "images"
D = viscous.D


def friction() -> Figure:
    """Mean skin friction of a plate along the flow, one body and ten segments."""
    figure = new_figure(6.4, 3.6)
    axes = figure.subplots()
    reynolds = np.geomspace(1e3, 3e7, 61)
    plate = viscous.in_viscous_water(viscous.single(Box((1.0, 1e-4, 1.0))))
    # Without the drag of the edge and of creeping flow.
    mean = viscous.coefficients(plate, 0, reynolds, 1.0, 2.0) - 1e-4 - 8 / reynolds
    axes.loglog(reynolds, mean, color=BLUE, label="plate of one body")
    segments = box_chain(10, "z", size=(0.0999, 1e-5, 1.0), gap=1e-4)
    chain = viscous.in_viscous_water(segments)
    speeds = reynolds[:, None] * viscous.VISCOSITY / viscous.WATER * np.eye(3)[0]
    drag = -viscous.force(chain, speeds)[:, 0] / (viscous.WATER * speeds[:, 0] ** 2)
    axes.loglog(reynolds, drag - 8 / reynolds, "--", color=RED, label="plate of ten segments")
    _points(axes, measured.FRICTION, GREY, "Blasius, Prandtl, transition at 5e5")
    _plain_ticks(axes.xaxis, axes.yaxis)
    axes.set_yticks([0.002, 0.005, 0.01, 0.02, 0.05])
    axes.set_xlabel("Reynolds number on the length")
    axes.set_ylabel("mean friction of one side")
    axes.legend(loc="upper right")
    axes.grid(True, which="major")
    return figure


def form_drag() -> Figure:
    """Drag coefficients on the frontal area against the Reynolds number, and against the length."""
    figure = new_figure(9.6, 3.9)
    left, right = figure.subplots(1, 2)
    reynolds = np.geomspace(0.5, 2e5, 61)
    long = 60
    bodies = (
        ("sphere", Sphere(D / 2), 0, viscous.FRONT, measured.SPHERE, BLUE),
        (
            "long cylinder across", Capsule(D / 2, (long - 1) * D), 1, long * D**2,
            measured.CYLINDER, RED,
        ),
        (
            "square plate across", Box((0.01 * D, D, D)), 0, D * D, measured.PLATE, GREEN,
        ),
    )  # fmt: skip
    for name, shape, direction, area, table, colour in bodies:
        left.loglog(reynolds, _drag(shape, direction, reynolds, area), color=colour, label=name)
        _points(left, table, colour)
    _plain_ticks(left.xaxis, left.yaxis)
    left.set_xlabel("Reynolds number on the thickness")
    left.set_ylabel("drag coefficient")
    left.set_ylim(0.2, 60)
    left.legend(loc="upper right", title="filled: measured")
    lengths = np.geomspace(0.05, 8, 41)
    families: tuple[tuple[str, Callable[[float], Shape], float, str, tuple], ...] = (
        (
            "box along", lambda x: Box((x * D, D, D)), D * D, GREEN,
            ((0.05, 1.17), (1, 1.05), (4, 0.85)),
        ),
        (
            "ellipsoid along", lambda x: Ellipsoid((x * D / 2, D / 2, D / 2)), viscous.FRONT, BLUE,
            ((1, 0.47), (2, 0.27), (4, 0.22), (8, 0.20)),
        ),
    )  # fmt: skip
    for name, family, area, colour, table in families:
        found = [_drag(family(x), 0, [1e5 / max(1.0, x)], area)[0] for x in lengths]
        right.semilogx(lengths, found, color=colour, label=name)
        _points(right, table, colour)
    right.set_xlabel("length over width")
    right.set_xticks([0.1, 1, 8], ["0.1", "1", "8"])
    right.xaxis.set_minor_formatter(NullFormatter())
    right.set_ylim(0, 1.6)
    right.legend(loc="upper right", title="Reynolds number 1e5")
    for axes in (left, right):
        axes.grid(True, which="major")
    return figure


def shelter() -> Figure:
    """Drag of a chain of 14 capsules along the flow over that of one capsule of its length."""
    figure = new_figure(6.4, 3.6)
    axes = figure.subplots()
    radius, capsule = test_outline.R, test_outline.CAPSULE
    gaps = np.linspace(-2.0, 4.0, 61)
    ratios = []
    for gap in gaps:
        chain = test_outline.chain([capsule] * 14, gap * radius)
        length = 14 * (capsule.length + 2 * radius) + 13 * gap * radius
        one = test_outline.capsule_drag(length, test_outline.ALONG)
        ratios.append(test_outline.drag(chain, test_outline.ALONG) / one)
    axes.plot(gaps, ratios, color=BLUE)
    axes.axhline(1.0, color=GREY, lw=0.8, ls="--")
    axes.set_xlabel("gap between the ends, radii")
    axes.set_ylabel("drag over that of one capsule")
    axes.set_ylim(0, 2)
    axes.grid(True)
    return figure


def reactive_thrust() -> Figure:
    """Thrust of a held plate and speed of a free plate, over elongated-body theory."""
    figure = new_figure(9.6, 3.8)
    held, free = figure.subplots(1, 2, sharey=True)
    for envelope, segments, name, colour, mark in (
        (thrust.CONSTANT, 20, "constant wave, 20 segments", BLUE, "o-"),
        (thrust.GROWING, 20, "growing wave, 20 segments", RED, "s-"),
        (thrust.GROWING, 40, "growing wave, 40 segments", RED, "^--"),
    ):
        found = thrust.held_thrust(segments, envelope)
        held.plot(thrust.SPEEDS, found, mark, color=colour, mfc="white", label=name)
    held.set_ylabel("computed over theory")
    held.set_title("thrust of a held plate")
    swim = thrust.swim(20, 1 / 120)
    own = 0.5 * thrust.WATER * thrust.FRICTION * 2 * (thrust.HEIGHT + thrust.THICKNESS)
    theory = np.array([thrust.plate(*wave).swimming_speed(own) for wave in thrust.WAVES])
    for envelope, name, colour, mark in (
        (thrust.CONSTANT, "constant wave", BLUE, "o"),
        (thrust.GROWING, "growing wave", RED, "s"),
    ):
        chosen = [wave[0] is envelope for wave in thrust.WAVES]
        ratio = swim.speed[chosen] / theory[chosen]
        free.plot(swim.speed[chosen], ratio, mark, color=colour, mfc="white", label=name)
        sizes = [wave[1] for wave in thrust.WAVES if wave[0] is envelope]
        for x, y, size in zip(swim.speed[chosen], ratio, sizes, strict=True):
            shift = (0, 8) if envelope is thrust.GROWING else (0, -15)
            free.annotate(
                f"{size:g} m", (x, y), shift, textcoords="offset points", ha="center",
                fontsize=8, color=colour,
            )  # fmt: skip
    free.set_title("speed of a free plate, by tail amplitude")
    for axes in (held, free):
        axes.axhline(1.0, color=GREY, lw=0.8, ls="--")
        axes.set_xlabel("swimming speed over wave speed, U/V")
        axes.set_xlim(0, 1)
        axes.set_ylim(0.6, 1.6)
        axes.legend(loc="upper left")
        axes.grid(True)
    return figure


def lift() -> Figure:
    """Lift of plates against the angle of attack, with measured values."""
    figure = new_figure(6.4, 3.8)
    axes = figure.subplots()
    angles = np.linspace(0, 90, 91)
    for (aspect, reynolds, table), colour, style in zip(
        measured.LIFT, (BLUE, RED, GREEN), ("-", "-", "--"), strict=True
    ):
        name = f"aspect ratio {aspect:g}, Re {'1.4e5' if reynolds > 1e3 else '100'}"
        chord = 0.2
        plate = test_lift.single(Box((chord, aspect * chord, 0.02 * chord)))
        world = test_lift.lifted(plate, viscosity=test_lift.WATER * chord / reynolds)
        force = test_lift.wrench(world, test_lift.at_angles(np.deg2rad(angles)))[3:]
        along, up = np.sin(np.deg2rad(angles)), np.cos(np.deg2rad(angles))
        found = (force[0] * along + force[2] * up) / (0.5 * test_lift.WATER * chord**2 * aspect)
        axes.plot(angles, found, style, color=colour, label=name)
        _points(axes, table, colour)
    axes.set_xlabel("angle of attack, degrees")
    axes.set_ylabel("lift coefficient")
    axes.set_xlim(0, 90)
    axes.set_xticks(range(0, 91, 15))
    axes.set_ylim(0, 1.2)
    axes.legend(loc="upper right", title="filled: measured")
    axes.grid(True)
    return figure


PICTURES = {
    "friction": friction,
    "form_drag": form_drag,
    "shelter": shelter,
    "reactive_thrust": reactive_thrust,
    "lift": lift,
}


def main(names: Sequence[str], folder: Path = IMAGES) -> None:
    """Write pictures to a folder, all of them without names."""
    with jax.enable_x64(True):
        for name in names or PICTURES:
            print(save_figure(framed(PICTURES[name])(), folder / f"water_{name}.png"))


def _drag(shape: Shape, direction: int, reynolds, area: float) -> np.ndarray:
    world = viscous.in_viscous_water(viscous.single(shape))
    return viscous.coefficients(world, direction, reynolds, D, area)


def _plain_ticks(*scales) -> None:
    """Label powers of ten as numbers, without formulas."""
    for scale in scales:
        scale.set_major_formatter(
            FuncFormatter(lambda x, _: f"{x:g}" if x < 1e3 else f"{x:.0e}".replace("e+0", "e"))
        )
        scale.set_minor_formatter(NullFormatter())


def _points(axes: Axes, table: Sequence[tuple[float, float]], colour: str, name: str = "") -> None:
    x, y = np.transpose(table)
    axes.plot(x, y, "o", color=colour, ms=5, label=name or None)


if __name__ == "__main__":
    main(sys.argv[1:])
