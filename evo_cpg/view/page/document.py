"""The page of a run: one HTML file that needs nothing else, on a screen and on paper.

Its scripts are ours and named by their digests in the page's content security policy, which allows
no others and no request: what a configuration from a stranger says is text, and stays text.
"""

import base64
import hashlib
import itertools
import json
import math
import shlex
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np

from evo_cpg.analysis.gait_numbers import GaitNumbers, Quantity
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.clip import Clip
from evo_cpg.view.page import charts
from evo_cpg.view.page.departures import Departures
from evo_cpg.view.page.html import Html, join, long_table, table, tag
from evo_cpg.view.plots import fitness_figure, joint_signals_figure, path_figure

# The part of a trial that charts of signals and footfalls show, s and strides.
_LEAST_SHOWN, _MOST_SHOWN, _STRIDES_SHOWN = 2.0, 8.0, 6.0
# Of the path only so many places are drawn.
_PLACES = 400
# Longest text of a cell.
_LETTERS = 120


class Subject(NamedTuple):
    """What a page is about.

    Attributes:
        name: of the experiment.
        changed: what is to be said of a configuration that the champion did not evolve in; None
            where it is the one.
        folder: name of the run folder.
        sentence: what evolved, where, for what.
        champion: fitness and terms, by name.
        generation: that the champion comes from.
        generations: that are done.
        run: which of several runs; None where there is one.
        trial: which of several trials; None where there is one.
        seed: of the experiment.
        chains: degrees of freedom in rows, as `plot_joint_signals` has them.
        signal: what the controller's signal is, with its unit.
        config: the resolved configuration, as a file.
        meta: contents of meta.json.
        audit: contents of audit.json; None where no audit was made.
        stale: whether that audit was of another champion.
        half_step: share of its way that it kept at half the physics step when training ended; None
            where that was not looked at.
        departures: from the shipped configuration and the paper; None where there is none of the
            name.
        program: that made the page, with its version.
        made: when.
    """

    name: str
    changed: str | None
    folder: str
    sentence: str
    champion: Mapping[str, float]
    generation: int
    generations: int
    run: int | None
    trial: int | None
    seed: int
    chains: Sequence[Sequence[int]]
    signal: str
    config: str
    meta: Mapping[str, Any]
    audit: Mapping[str, Any] | None
    stale: bool
    half_step: float | None
    departures: Departures | None
    program: str
    made: str


class Motion(NamedTuple):
    """How it moves.

    Attributes:
        recording: the motion.
        clip: the same at the viewer's frames.
        numbers: measured from it.
        scene: for the viewer.
        still: a picture, JPEG.
        history: columns of metrics.csv.
        chain_places: of the joints along the body, m behind the first.
    """

    recording: Recording
    clip: Clip
    numbers: GaitNumbers
    scene: Mapping[str, Any]
    still: bytes
    history: Mapping[str, np.ndarray]
    chain_places: np.ndarray


def document(subject: Subject, motion: Motion) -> str:
    """The whole page."""
    sections = [
        ("gait", "How it moves", _gait(motion)),
        ("signals", "Signals", _signals(subject, motion)),
        ("effort", "Power and torque", _effort(motion)),
        ("numbers", "All numbers", _numbers(motion.numbers.quantities)),
        ("evolution", "How it evolved", _evolution(subject, motion)),
        ("audit", "Is it a gait, or a trick of the simulation?", _audit(subject)),
        ("paper", "Departures from the paper", _paper(subject)),
        ("repeat", "How to repeat it", _repeat(subject)),
    ]
    shown = [(key, title, inner) for key, title, inner in sections if inner]
    scripts = [_asset("three.min.js"), _asset("viewer.js")]
    body = tag(
        "body",
        tag("h1", f"{subject.name}: its champion"),
        tag("p", subject.sentence, class_="lead"),
        _changed(subject),
        tag("nav", *(tag("a", title, href=f"#{key}") for key, title, _ in shown)),
        _viewer(motion),
        _cards(subject, motion.numbers),
        *(
            tag("section", tag("h2", title), inner, id=key, aria_label=title)
            for key, title, inner in shown
        ),
        tag(
            "footer",
            f"Made by {subject.program} on {subject.made}. The animal is drawn by three.js (MIT "
            "licence); this page asks the network for nothing.",
        ),
        _json_script("scene", motion.scene),
        *(Html(f"<script>{script}</script>") for script in scripts),
    )
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=_policy(scripts)),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="generator", content="evo-cpg analyse"),
        tag("title", f"{subject.name}: its champion"),
        Html(f"<style>{_asset('page.css')}</style>"),
    )
    return "<!doctype html>\n" + tag("html", head, body, lang="en")


def _changed(subject: Subject) -> Html | None:
    """That numbers are those of another animal or world than the champion evolved in."""
    if subject.changed is None:
        return None
    words = f"{subject.changed}: all that is measured here is of its trial as it comes out now."
    return tag("p", words, class_="failed")


def _viewer(motion: Motion) -> Html:
    still = base64.b64encode(motion.still).decode()
    views = [("side", "Side"), ("top", "Top"), ("behind", "Behind"), ("front", "Front")]
    paces = [("0.1", "0.1 x"), ("0.25", "0.25 x"), ("0.5", "0.5 x"), ("1", "1 x"), ("2", "2 x")]
    screen = tag(
        "div",
        tag("img", class_="still", src=f"data:image/jpeg;base64,{still}", alt="the animal"),
        tag("canvas", tabindex=0, aria_label="The animal in 3D: space plays, arrows step"),
        tag("div", class_="caption"),
        class_="screen",
    )
    controls = tag(
        "div",
        tag("button", "Play", class_="play", type="button", aria_pressed="false"),
        tag("input", type="range", min=0, max=1, value=0, aria_label="time"),
        tag("span", class_="clock"),
        tag(
            "select",
            *(tag("option", word, value=key, selected=key == "1") for key, word in paces),
            class_="pace",
            aria_label="speed",
        ),
        tag(
            "span",
            *(tag("button", word, type="button", data_view=key) for key, word in views),
            tag("button", "+", type="button", data_zoom="0.8", aria_label="nearer"),
            tag("button", "\N{MINUS SIGN}", type="button", data_zoom="1.25", aria_label="farther"),
            class_="group",
        ),
        tag("label", tag("input", class_="follow", type="checkbox", checked=True), " follow"),
        tag(
            "span",
            "drag to turn, right button to move, Ctrl or Shift and wheel to zoom",
            class_="note hint",
        ),
        class_="controls",
    )
    return tag("div", screen, controls, id="animal")


def _cards(subject: Subject, numbers: GaitNumbers) -> Html:
    """The numbers that matter first."""
    found = [("fitness", _number(subject.champion["fitness"]))]
    for key in ("speed", "speed_in_lengths", "stride_frequency", "strouhal", "duty_factor",
                "cost_of_transport", "power"):  # fmt: skip
        for each in numbers.quantities:
            if each.key == key:
                found.append((each.name, _with_unit(each)))
    return tag(
        "ul", *(tag("li", tag("b", value), tag("span", name)) for name, value in found),
        class_="cards",
    )  # fmt: skip


def _gait(motion: Motion) -> Html:
    numbers, recording = motion.numbers, motion.recording
    window = _window(recording, numbers.frequency)
    parts: list[Any] = []
    feet, wave = numbers.feet, numbers.wave
    if feet is not None and feet.names:
        parts += [
            tag("h3", "Footfalls"),
            charts.chart(
                charts.footfall_figure(feet, numbers.step, window),
                "When what touches the ground: a bar is a stance. Click into a chart, and the "
                "animal goes to that instant.",
                timed=True,
            ),
            _feet_table(numbers),
        ]
    elif feet is not None:
        parts.append(tag("p", "Nothing but its root ever touches the ground."))
    if wave is not None:
        chain = list(numbers.chain)
        names = [recording.dof_names[i].rpartition(".")[0] for i in chain]
        bending = np.asarray(recording.joint_angle)[:, chain] * numbers.axis_signs[chain]
        parts += [
            tag("h3", "The wave along the body"),
            charts.chart(
                charts.wave_figure(bending, numbers.step, window, names),
                f"Bending of each joint about {recording.dof_names[chain[0]].rpartition('.')[2]} "
                "over time, the front above. A wave that runs to the tail slants to the lower "
                "right; one that stands is upright.",
                timed=True,
            ),
        ]
        if math.isfinite(wave.count):
            parts.append(
                charts.chart(
                    charts.lag_figure(wave, motion.chain_places),
                    f"Phase and amplitude at {numbers.frequency:.3g} Hz. A straight line is a wave "
                    f"of one speed; here {100 * wave.straightness:.0f} % of the phases' variance "
                    "is that of a line.",
                )
            )
    places = max(1, len(recording.time) // _PLACES)
    parts += [
        tag("h3", "Its way"),
        charts.chart(
            path_figure(_every(recording, places)), "From above, and the distance over time."
        ),
    ]
    return join(*parts)


def _feet_table(numbers: GaitNumbers) -> Html:
    feet = numbers.feet
    assert feet is not None
    rows = []
    reference = feet.phases.reference
    for i, name in enumerate(feet.names):
        phase = _number(feet.phases.phase[i])
        rows.append(
            [
                name,
                _number(feet.duty_factor[i]),
                f"{phase} (reference)" if i == reference else phase,
                _number(feet.phases.regularity[i]),
                _number(feet.slip[i]),
            ]
        )
    words = (
        "Phase: where in the stride of the reference it touches down, from 0 to 1 (Hildebrand "
        "1965); regularity: 1 where always at the same, 0 where at any time."
    )
    head = ["body", "duty factor", "phase", "regularity", "slip (m/s)"]
    return join(table(head, rows, numbers=(1, 2, 3, 4)), tag("p", words, class_="note"))


def _signals(subject: Subject, motion: Motion) -> Html | None:
    recording, numbers = motion.recording, motion.numbers
    if not recording.dof_names:
        return None
    window = _window(recording, numbers.frequency)
    figure = joint_signals_figure(
        recording,
        window=window,
        chains=subject.chains,
        signs=numbers.axis_signs,
        signal=subject.signal,
    )
    parts: list[Any] = [
        charts.chart(
            figure,
            "Angle of every joint about the axis that bends most, and what drives it. Thin lines "
            "join crests of neighbours, or a crest and a trough where their axes point against "
            "each other: their slope is the phase lag.",
            timed=True,
        )
    ]
    rows = []
    for row in subject.chains:
        for before, after in itertools.pairwise(row):
            lag = numbers.lags.lag[before, after]
            if math.isfinite(lag):
                rows.append(
                    [
                        recording.dof_names[before],
                        recording.dof_names[after],
                        _number(round(float(lag))),
                        _number(numbers.lags.coherence[before, after]),
                    ]
                )
    if rows:
        words = (
            f"By how much a joint is behind the one before it at {numbers.frequency:.3g} Hz, from "
            "the cross-spectrum of their angles (Welch 1967), both about the direction of the axis "
            "of the first in the row; coherence: 1 where the lag is always the same, 0 where it is "
            "anything."
        )
        made = long_table(["joint", "next", "lag (deg)", "coherence"], rows, numbers=(2, 3))
        parts += [tag("h3", "Phase lags"), made, tag("p", words, class_="note")]
    elif not numbers.frequency > 0:
        parts.append(tag("p", "The joints do not repeat themselves, so there are no phase lags."))
    return join(*parts)


def _effort(motion: Motion) -> Html:
    recording, numbers, clip = motion.recording, motion.numbers, motion.clip
    figure = charts.effort_figure(recording.time, numbers.power, clip.time, clip.speed)
    order = np.argsort(-numbers.peak_torque)
    rows = [
        [
            recording.dof_names[i],
            _number(float(numbers.peak_torque[i])),
            _number(float(numbers.rms_torque[i])),
            _number(np.degrees(np.ptp(recording.joint_angle[:, i]) / 2)),
        ]
        for i in order
    ]
    parts: list[Any] = [
        charts.chart(
            figure,
            "Power of all motors, in tenths of a second, and speed of the animal's middle, "
            "averaged over half a second.",
            timed=True,
        )
    ]
    if rows:
        head = ["joint", "peak torque (N m)", "rms torque (N m)", "half range (deg)"]
        parts.append(long_table(head, rows, numbers=(1, 2, 3)))
    return join(*parts)


def _numbers(quantities: Sequence[Quantity]) -> Html:
    rows = [
        [
            each.name,
            _number(each.value),
            each.unit,
            f"{each.definition}. None: {each.missing}." if each.missing else each.definition,
        ]
        for each in quantities
    ]
    return table(["", "value", "unit", "what it is"], rows, numbers=(1,))


def _evolution(subject: Subject, motion: Motion) -> Html:
    rows = [[name, _number(value)] for name, value in subject.champion.items()]
    words = (
        f"The champion comes from generation {subject.generation} (counted from 0; "
        f"{subject.generations} are done), with the seed {subject.seed}"
    )
    if subject.run is not None:
        words += f", run {subject.run}"
    if subject.trial is not None:
        words += f"; this is its trial {subject.trial}"
    return join(
        tag("p", words + "."),
        charts.chart(
            fitness_figure(motion.history),
            "Fitness over the generations, and how many individuals diverged or broke a rule.",
        ),
        table(["", "champion"], rows, numbers=(1,)),
        tag("p", "Fitness is maximised; the other rows are the terms that it is made of.",
            class_="note"),
    )  # fmt: skip


def _audit(subject: Subject) -> Html:
    audit, command = subject.audit, tag("code", "evo-cpg audit RUN")
    look: Any = None
    if subject.half_step is not None:
        look = tag(
            "p", f"At half the physics step it keeps {100 * subject.half_step:.3g} % of its way."
        )
    if audit is None:
        return join(
            look, tag("p", "It was not audited. ", command, " looks closer, and this page tells "
                      "its verdict when it is made again.")
        )  # fmt: skip
    passed = bool(audit.get("passed"))
    verdict = tag("span", "passes" if passed else "does not pass",
                  class_="passed" if passed else "failed")  # fmt: skip
    old = None
    if subject.stale:
        old = tag("p", "That audit was of another champion; ", command, " looks at this one.",
                  class_="failed")  # fmt: skip
    reasons = [reason for reason in _list(audit.get("reasons")) if isinstance(reason, str)]
    rows = []
    for check in _list(audit.get("checks")):
        if isinstance(check, Mapping):
            passed = check.get("passed")
            word = {True: "passed", False: "failed"}.get(passed) if passed is not None else ""
            limit = _share(check.get("limit"), check.get("unit"))
            if limit:
                limit = f"{'at least' if check.get('least') else 'at most'} {limit}"
            measured = _share(check.get("measured"), check.get("unit"))
            rows.append([check.get("question", ""), measured or "diverged", limit,
                         tag("span", word, class_=word)])  # fmt: skip
    return join(
        old,
        tag("p", "The champion ", verdict, " its audit", f" of {audit.get('made', '')}.", *(
            [" ", "; ".join(reasons), "."] if reasons else [])),
        table(["check", "measured", "allowed", ""], rows, numbers=(1, 2)),
    )  # fmt: skip


def _paper(subject: Subject) -> Html | None:
    found = subject.departures
    if found is None:
        return None
    parts: list[Any] = [tag("p", found.about)]
    if found.differences:
        rows = [[tag("code", d.key), _cell(d.shipped), _cell(d.own)] for d in found.differences]
        parts += [
            tag("h3", "This run against the shipped configuration"),
            long_table(["key", "shipped", "this run"], rows),
        ]
    else:
        parts.append(tag("p", "This run has all values of the shipped configuration."))
    if found.notes:
        rows = [
            [tag("code", note.key), _cell(note.value), "ours" if note.ours else "paper", note.text]
            for note in found.notes
        ]
        parts += [
            tag("h3", "The shipped configuration against the paper"),
            tag("p", "What the paper gives, and what it leaves open and is ours, as the shipped "
                "files say beside their values.", class_="note"),
            table(["key", "shipped value", "whose", "note"], rows),
        ]  # fmt: skip
    return join(*parts)


def _repeat(subject: Subject) -> Html:
    run, meta = subject.folder, subject.meta
    commands = [
        "evo-cpg train config.yaml --out again",
        f"evo-cpg verify {shlex.quote(run)}",
        f"evo-cpg render {shlex.quote(run)}",
        f"evo-cpg analyse {shlex.quote(run)}",
    ]
    rows = [[key, _cell(meta[key])] for key in ("started", "resumed", "finished") if key in meta]
    versions = meta.get("versions")
    if isinstance(versions, Mapping):
        said = ", ".join(f"{name} {version}" for name, version in versions.items())
        rows.append(["versions", f"Python {meta.get('python', '?')}, {said}"])
    for key in ("commit", "processor", "system", "engine", "instructions", "devices", "processes"):
        if key in meta:
            rows.append([key, _cell(meta[key])])
    digest = hashlib.sha256(subject.config.encode()).hexdigest()
    rows.append(["configuration", f"SHA-256 {digest}"])
    command = meta.get("command")
    if isinstance(command, list):
        words = [_without_folders(str(word)) for word in command]
        rows.append(["first command", f"evo-cpg {shlex.join(words)}"])
    return join(
        tag("p", "With the configuration below as ", tag("code", "config.yaml"), ", on the same "
            "processor, with the same versions and number of cores, the same comes out bit for "
            "bit; elsewhere numbers round differently, and evolution may take another turn. A "
            "configuration that names files, such as meshes, or classes of its own needs those, "
            "too."),
        tag("pre", tag("code", "\n".join(commands))),
        table(["", ""], rows),
        tag("details", tag("summary", "The configuration"), tag("pre", tag("code",
            subject.config))),
    )  # fmt: skip


def _window(recording: Recording, frequency: float) -> tuple[float, float]:
    """The part that charts over time show: some strides in the middle of the second half, s."""
    start, end = float(recording.time[0]), float(recording.time[-1])
    length = _STRIDES_SHOWN / frequency if frequency > 0 else _MOST_SHOWN
    length = min(max(length, _LEAST_SHOWN), _MOST_SHOWN, end - start)
    middle = start + 0.75 * (end - start)
    first = max(start, min(middle - length / 2, end - length))
    return first, first + length


def _every(recording: Recording, step: int) -> Recording:
    arrays = {
        name: value[::step] if name not in ("goal", "dof_names") else value
        for name, value in recording._asdict().items()
    }
    return Recording(**arrays)


def _number(value: float | np.floating) -> str:
    """Three digits; a dash where there is none."""
    if not math.isfinite(value):
        return "\N{EN DASH}"
    words = f"{value:.3g}"
    if "e" in words:
        words = f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else words
    return words.replace("-", "\N{MINUS SIGN}", 1) if words.startswith("-") else words


def _with_unit(each: Quantity) -> str:
    return f"{_number(each.value)} {each.unit}".rstrip()


def _share(value: Any, unit: Any) -> str:
    if not _is_number(value):
        return ""
    return f"{100 * value:.3g} %" if unit == "%" else f"{value:.3g} {unit}".rstrip()


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _cell(value: Any) -> str:
    if value is None:
        return "\N{EN DASH}"
    words = f"{value:.6g}" if isinstance(value, float) else str(value)
    return words if len(words) <= _LETTERS else words[: _LETTERS - 3] + "..."


def _without_folders(word: str) -> str:
    """A path without the folders that it is in: pages are shown to others."""
    key, mark, value = word.partition("=")
    place = value if mark else word
    if PurePath(place).is_absolute() or place.startswith("~"):
        return f"{key}{mark}{PurePath(place).name}" if mark else PurePath(place).name
    return word


def _asset(name: str) -> str:
    return resources.files("evo_cpg.view.page").joinpath(name).read_text(encoding="utf-8")


def _json_script(name: str, values: Mapping[str, Any]) -> Html:
    # Within a script nothing is escaped, and its end is wherever "</" stands.
    text = json.dumps(values, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return Html(f'<script type="application/json" id="{name}">{text}</script>')


def _policy(scripts: Sequence[str]) -> str:
    digests = [
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts
    ]
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: "
        "blob:; base-uri 'none'; form-action 'none'"
    )
