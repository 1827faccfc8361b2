"""Figures of a run and of a recording, in SI units."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import ConnectionPatch
from matplotlib.ticker import MaxNLocator

from evo_cpg.analysis.gait import bending_axis, dominant_frequency, fourier_component
from evo_cpg.creature.axis_kinds import body_and_axis
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.figure import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    RED,
    TIME,
    draw_runs,
    framed,
    new_figure,
    right_axis,
)
from evo_cpg.view.legible import legible

_PALE_ORANGE = "#f3cf8a"
# Recorded time that `joint_signals_figure` shows by default: about five beats of 1 Hz.
_WINDOW = 5.0
# Style of the title of a row of joint signals.
_NAME: dict[str, Any] = {"fontsize": 9, "fontweight": "bold", "pad": 2}
_SNAPSHOTS = 7
# Number of the thin lines of runs, times their opacity.
_INK_OF_RUNS = 2.0
# Smallest number of periods of a rhythm in the window. The spectrum of a drift peaks at 2 periods.
_PERIODS = 2.1


@framed
def fitness_figure(history: Mapping[str, np.ndarray]) -> Figure:
    """Draw fitness over the generations and, if any individuals diverged, their number.

    Thin lines of several runs show the best of each generation in each run, as in Figs. 4-2 to 4-6
    of Fukui 2003. Thick lines are medians over the runs, and half of the runs lie within the band.

    Args:
        history: columns of equal length: ``generation``, ``best``, ``mean`` and ``diverged``
            (number of individuals). Optional: ``best_so_far`` and ``run``. Values that are not
            finite are left out.

    Raises:
        ValueError: a column is missing or there are no rows.
    """
    missing = [key for key in ("generation", "best", "mean", "diverged") if key not in history]
    if missing:
        raise ValueError(f"the history has no column {missing[0]!r}, only {', '.join(history)}")
    columns = {key: np.asarray(values, float) for key, values in history.items()}
    generation, column = np.unique(columns["generation"], return_inverse=True)
    if not len(generation):
        raise ValueError("the history has no rows yet, because no generation is finished")
    runs, row = np.unique(columns.get("run", np.zeros(len(column))), return_inverse=True)

    def by_run(key: str) -> Float[np.ndarray, "runs generations"]:
        table = np.full((len(runs), len(generation)), np.nan)
        table[row, column] = np.where(np.isfinite(columns[key]), columns[key], np.nan)
        return table

    figure, diverged = new_figure(7.2, 4.8), np.nansum(by_run("diverged"), 0)
    rows = 2 if diverged.any() else 1
    panels = figure.subplots(rows, 1, sharex=True, height_ratios=(4, 1)[:rows], squeeze=False)
    top, bottom = panels[0, 0], panels[-1, 0]
    several, of_runs = len(runs) > 1, ", median" if len(runs) > 1 else ""
    if several:
        # Many lines are faint, so that the median stands out.
        faint = min(0.4, _INK_OF_RUNS / len(runs))
        (*_, thin) = top.plot(generation, by_run("best").T, color=BLUE, lw=0.7, alpha=faint)
        thin.set_label("best of the generation, each run")
    for key, label, color, width in (
        # Wide, so that it is visible below the other line if an elite keeps the two bests equal.
        ("best_so_far", "best so far", _PALE_ORANGE, 5.0),
        ("best", "best of the generation", BLUE, 1.5),
        ("mean", "mean of the generation", GREY, 1.3),
    ):
        if key in columns:
            band = key == "best"
            draw_runs(top, generation, by_run(key), color, label + of_runs, width=width, band=band)
    top.set_ylabel("fitness")
    top.legend(title=f"{len(runs)} runs, half of them in the band" if several else None)
    if diverged.any():
        bottom.bar(generation, diverged, width=1.0, color=RED)
        bottom.set(ylabel="diverged", ylim=(0, diverged.max() * 1.15))
        bottom.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=3))
    bottom.set_xlabel("generation")
    bottom.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    return figure


@framed
def joint_signals_figure(
    recording: Recording,
    axis: str | None = None,
    window: tuple[float, float] | None = None,
    *,
    chains: Sequence[Sequence[int]] = (),
    signs: Float[np.ndarray, " d"] | None = None,
    title: str = "",
    signal: str = "CPG output (no unit)",
) -> Figure:
    """Draw angle and CPG output of every joint about one axis, a row each (Iwadate 2010, Fig. 3).

    A thin line joins the crests of neighbouring joints of a chain. If their axes point against each
    other, the line joins a crest and a trough. Its slope is the phase lag along the body.

    Args:
        recording: the motion.
        axis: axis such as ``z``, or ``slide_x`` for slides along x. The default is the axis about
            which the animal bends most.
        window: first and last instant to show, s. By default 5 s in the middle of the second half:
            the animal has started by then, and has not arrived.
        chains: degrees of freedom that follow one another along the body, by their numbers in the
            recording. The rows follow them, chain after chain. If there are no chains, the rows
            follow the recording from the root to the tips, as one chain.
        signs: for each degree of freedom, -1 if its axis points against the first axis of its
            chain (`evo_cpg.analysis.chains.axis_signs`). None means that all signs are 1.
        title: text such as the name of the run.
        signal: name of the dashed line's quantity, with its unit.

    Raises:
        ValueError: no joint has this axis, or the window holds fewer than two instants.
    """
    names = [body_and_axis(name) for name in recording.dof_names]
    available = list(dict.fromkeys(letter for _, letter in names))
    if not available:
        raise ValueError("the recording has no joints, so there are no signals to plot")
    axis = bending_axis(recording) if axis is None else axis
    if axis not in available:
        raise ValueError(f"no joint has the axis {axis!r}. Allowed: {', '.join(available)}")
    end = recording.time[-1]
    start, stop = window or (max(0.0, 0.75 * end - _WINDOW / 2), 0.75 * end + _WINDOW / 2)
    shown = (recording.time >= start) & (recording.time <= stop)
    if shown.sum() < 2:
        raise ValueError(
            f"the window from {start:g} s to {stop:g} s holds {shown.sum()} recorded instants, but "
            f"needs 2. The recording runs from {recording.time[0]:g} s to {end:g} s"
        )
    left, groups = [i for i, name in enumerate(names) if name[1] == axis], []
    for chain in chains:
        groups.append([row for row in chain if row in left])
        left = [row for row in left if row not in chain]
    # Joints that belong to no chain are the last group.
    groups = [group for group in [*groups, left] if group]
    rows = [row for group in groups for row in group]
    time = recording.time[shown]
    angle = recording.joint_angle[shown][:, rows]
    word, unit, about = "displacement", "m", "along"
    if not recording.slides[rows].any():
        word, unit, about, angle = "joint angle", "deg", "about", np.degrees(angle)
    output = recording.cpg_output[shown][:, rows]
    swing = angle if signs is None else angle * signs[rows]

    figure = new_figure(8.0, 1.3 + 0.86 * len(rows))
    panels = figure.subplots(len(rows), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    lines = _draw_rows(panels, time, {f"{word} ({unit})": angle, signal: output})
    for panel, row in zip(panels, rows, strict=True):
        # Above the row, where no curve runs.
        panel.set_title(legible(names[row][0]), loc="left", **_NAME)
    caption = f"joint signals {about} {axis.removeprefix('slide_')}"
    caption = f"{legible(title)}: {caption}" if title else caption
    first = 0
    for group in groups:
        own = slice(first, first + len(group))
        beat = _crests(time, swing[:, own])
        if beat is not None:
            frequency, lag, crest_times = beat
            _join_crests(figure, panels[own], crest_times, time, angle[:, own])
        if beat is not None and not first:
            ends = [legible(names[group[i]][0]) for i in (0, -1)]
            where = f" from {ends[0]} to {ends[1]}" if len(groups) > 1 and len(group) > 1 else ""
            degrees = np.degrees(lag.mean()) if len(lag) else 0
            caption += f"\n{frequency:.2f} Hz, {degrees:.0f} deg of lag per joint{where}"
        first += len(group)
    panels[-1].set_xlabel("time (s)")
    figure.suptitle(caption, fontsize=11)
    words = [word, signal.partition(" (")[0]]
    figure.legend(lines, words, loc="outside lower center", ncols=2)
    return figure


def _draw_rows(
    panels: np.ndarray, time: np.ndarray, signals: Mapping[str, np.ndarray]
) -> list[Line2D]:
    """Draw a row for each joint, with a scale on either side, and return one line of each kind.

    The first signals ``(t, d)`` are solid lines, the second ones dashed lines.
    """
    styles = ((BLUE, 1.8, "solid"), (RED, 1.2, (0, (4, 2))))
    tops = [1.25 * max(float(np.abs(values).max()), 1e-3) for values in signals.values()]
    lines = []
    for i, panel in enumerate(panels):
        panel.axhline(0, color=GREY, lw=0.5, alpha=0.6)
        panel.set_xlim(time[0], time[-1])
        scales = panel, right_axis(panel)
        for axes, (label, values), (color, width, style), top in zip(
            scales, signals.items(), styles, tops, strict=True
        ):
            lines += axes.plot(time, values[:, i], color=color, lw=width, ls=style)
            axes.set_ylim(-top, top)
            axes.yaxis.set_major_locator(MaxNLocator(3, symmetric=True))
            axes.tick_params(labelsize=8)
            if i == len(panels) // 2:
                axes.set_ylabel(label, color=color)
    return lines[:2]


@framed
def path_figure(recording: Recording, root_index: int) -> Figure:
    """Draw the root's path from above, with outlines of the animal, and the distance over time.

    The distance is measured to the light. Without a light it is the displacement from the start.
    """
    figure = new_figure(10.5, 4.4)
    above, later = figure.subplots(1, 2, width_ratios=(1.45, 1))
    root = recording.position[:, root_index, :2]
    steps = np.stack([root[:-1], root[1:]], 1)
    trace = LineCollection(list(steps), cmap=TIME, lw=2.2)
    trace.set_array(recording.time[:-1])
    above.add_collection(trace)
    chosen = np.linspace(0, len(recording.time) - 1, _SNAPSHOTS).astype(int)
    bodies = recording.position[chosen]
    instant = np.repeat(recording.time[chosen], bodies.shape[1])
    dots = above.scatter(
        bodies[..., 0], bodies[..., 1], s=14, c=instant, cmap=TIME, norm=trace.norm, lw=0
    )
    every = (recording.time[-1] - recording.time[0]) / (_SNAPSHOTS - 1)
    dots.set(alpha=0.8, label=f"bodies, every {every:.3g} s")
    above.plot(*root[0], "o", color=INK, ms=6, label="start of the root", zorder=3)
    light, stands = recording.light[:, :2], recording.appearances
    lit = len(stands) > 0
    if lit:
        star: dict[str, Any] = {"ls": "", "marker": "*", "color": ORANGE, "mec": INK, "ms": 17}
        glides = bool(np.any(light[-1] != light[stands[-1]]))
        names = (
            "lights in order" if len(stands) > 1 else "light at the start" if glides else "light"
        )
        above.plot(*light[stands].T, **star, label=names, zorder=3)
        for number, place in enumerate(light[stands] if len(stands) > 1 else (), 1):
            above.annotate(str(number), place, (7, 7), textcoords="offset points", zorder=4)
        for path in np.split(light, stands[1:]) if glides else ():
            above.plot(*path.T, color=ORANGE, lw=1)
        if glides:
            above.plot(*light[-1], **star | {"mfc": "white"}, label="light at the end", zorder=3)
    above.set_aspect("equal", "datalim")
    above.margins(0.08)
    above.autoscale_view()
    above.set(xlabel="x (m)", ylabel="y (m)")
    above.legend()
    figure.colorbar(trace, ax=above, label="time (s)", shrink=0.85, pad=0.02)
    later.plot(recording.time, recording.distance, color=BLUE, lw=2)
    later.set(
        xlabel="time (s)",
        ylabel="distance to the light (m)" if lit else "distance from the start (m)",
        xlim=(recording.time[0], recording.time[-1]),
        ylim=(0, 1.08 * np.nanmax(recording.distance, initial=1e-3)),
    )
    return figure


def _crests(
    time: np.ndarray, angle: np.ndarray
) -> tuple[float, np.ndarray, list[np.ndarray]] | None:
    """Return frequency (Hz), lag of each joint behind its neighbour (rad), and crest times (s).

    The joint that swings most gives the frequency. The result is None without a rhythm.
    """
    step, span = float(time[1] - time[0]), float(time[-1] - time[0])
    frequency = float(dominant_frequency(angle, step)[angle.std(0).argmax()])
    if frequency * span < _PERIODS:
        return None
    component = fourier_component(angle, step, frequency)
    lag = np.angle(component[:-1] / component[1:])
    behind = np.concatenate([[0.0], np.cumsum(lag)])
    turn = 2 * np.pi
    # A wave that runs along the body may begin or end outside the shown time.
    margin = np.ceil(np.abs(behind).max() / turn) + 1
    beats = np.arange(-margin, span * frequency + margin) - np.angle(component[0]) / turn
    return frequency, lag, [time[0] + (beat + behind / turn) / frequency for beat in beats]


def _join_crests(
    figure: Figure,
    panels: np.ndarray,
    crest_times: list[np.ndarray],
    time: np.ndarray,
    angle: np.ndarray,
) -> None:
    """Draw the lines that run through one crest in every row."""
    for crests in crest_times:
        for i in range(len(panels) - 1):
            upper, lower = crests[i], crests[i + 1]
            if min(upper, lower) < time[0] or max(upper, lower) > time[-1]:
                continue
            ends = [
                (instant, np.interp(instant, time, angle[:, row]))
                for instant, row in ((upper, i), (lower, i + 1))
            ]
            line = ConnectionPatch(
                ends[0], ends[1], "data", "data", axesA=panels[i], axesB=panels[i + 1]
            )
            line.set(color=GREEN, lw=1.1, alpha=0.85)
            figure.add_artist(line)
