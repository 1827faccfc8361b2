"""The page of a run: one self-contained HTML file for screen and paper.

The content security policy of the page names its scripts by their digests, and allows no other
script and no request. Text from a configuration of unknown origin stays text.
"""

import base64
import json
from collections.abc import Mapping, Sequence
from typing import Any

from evo_cpg.view.run_page import movement, origin
from evo_cpg.view.run_page.html import Html, asset, join, number, tag, whole_page
from evo_cpg.view.run_page.subject import PageSubject, RecordedMotion

_ALONE = """
html, body { height: 100%; }
body { max-width: none; padding: 0; }
#animal { height: 100%; margin: 0; display: flex; flex-direction: column; }
#animal .screen { flex: 1 1 0; min-height: 8rem; aspect-ratio: auto; }
.hint { display: none; }
"""
_WIDE = "body { max-width: 90rem; }"


def document(subject: PageSubject, motion: RecordedMotion) -> str:
    """Return the whole page."""
    sections = [
        ("gait", "How it moves", movement.gait(motion)),
        ("signals", "Signals", movement.signals(subject, motion)),
        ("effort", "Power and torque", movement.effort(motion)),
        ("numbers", "All numbers", movement.all_numbers(motion.numbers.quantities)),
        ("evolution", "How it evolved", origin.evolution(subject, motion)),
        ("audit", "Is it a gait, or a trick of the simulation?", origin.audit(subject)),
        ("repeat", "How to repeat it", origin.repetition(subject)),
    ]
    shown = [(key, title, inner) for key, title, inner in sections if inner]
    changed = None
    if subject.changed is not None:
        words = "All numbers on this page describe a trial with the changed configuration."
        changed = tag("p", f"{subject.changed}. {words}", class_="failed")
    cards = [("fitness", number(subject.champion["fitness"]))]
    for key in ("speed", "speed_in_lengths", "stride_frequency", "strouhal", "duty_factor",
                "cost_of_transport", "power"):  # fmt: skip
        for each in motion.numbers.quantities:
            if each.key == key:
                cards.append((each.name, f"{number(each.value)} {each.unit}".rstrip()))
    items = (tag("li", tag("b", value), tag("span", name)) for name, value in cards)
    return _whole(
        f"{subject.name}: its champion",
        motion.scene,
        asset("page.css"),
        tag("h1", f"{subject.name}: its champion"),
        tag("p", subject.sentence, class_="lead"),
        changed,
        tag("nav", *(tag("a", title, href=f"#{key}") for key, title, _ in shown)),
        player(_still(motion.still)),
        tag("ul", *items, class_="cards"),
        *(
            tag("section", tag("h2", title), inner, id=key, aria_label=title)
            for key, title, inner in shown
        ),
        tag(
            "footer",
            f"Made by {subject.program} on {subject.made}. The animal is drawn by three.js (MIT "
            "licence). This page makes no network requests.",
        ),
    )


def animal_alone(title: str, scene: Mapping[str, Any], picture: bytes) -> str:
    """Return a page that has nothing but the animal, and fills its window or frame.

    Browsers without WebGL show the picture (JPEG) instead.
    """
    style = asset("page.css") + _ALONE
    return _whole(title, scene, style, player(_still(picture)))


def wall_document(
    title: str,
    note: str,
    legend: Sequence[tuple[str, str]],
    scene: Mapping[str, Any],
    picture: bytes,
) -> str:
    """Return a page with a wall of animals.

    Args:
        title: title of the page.
        note: sentence below the title.
        legend: colours and their words.
        scene: data of the viewer.
        picture: the wall as JPEG, for browsers without WebGL.
    """
    marks = (tag("li", tag("i", style=f"background:{color}"), words) for color, words in legend)
    return _whole(
        title,
        scene,
        asset("page.css") + _WIDE,
        tag("h1", title),
        tag("p", note, class_="lead"),
        player(_still(picture), (("side", "Front"),), follows=False),
        tag("ul", *marks, class_="legend"),
    )


def _whole(title: str, scene: Mapping[str, Any], style: str, *body: Html | None) -> str:
    """Return a page with the data of its viewer."""
    # Text within a script is not escaped, and "</" would end the script.
    text = json.dumps(scene, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    data = tag("script", Html(text), type="application/json", id="scene")
    scripts = [asset(name) for name in ("three.min.js", "animal.js", "viewer.js")]
    return whole_page(title, style, join(*body, data), scripts).text


_VIEWS = ("side", "Side"), ("top", "Top"), ("behind", "Behind"), ("front", "Front")


def player(before: Html, views: Sequence[tuple[str, str]] = _VIEWS, follows: bool = True) -> Html:
    """Return the screen and the controls of the animal in 3D.

    Args:
        before: what the screen shows before the animal, and without WebGL.
        views: names of views, and the words on their buttons.
        follows: whether the camera can follow the animal.
    """
    follow = tag("label", tag("input", class_="follow", type="checkbox", checked=True), " follow",
                 hidden=not follows)  # fmt: skip
    buttons = [tag("button", word, type="button", data_view=key) for key, word in views]
    paces = [
        tag("option", f"{pace} x", value=pace, selected=pace == "1")
        for pace in ("0.1", "0.25", "0.5", "1", "2")
    ]
    return Html(
        f"""<div id="animal">
<div class="screen">
{before}
<canvas tabindex="0" aria-label="The animal in 3D. Space plays, arrow keys step."></canvas>
<div class="caption"></div>
</div>
<div class="controls">
<button class="play" type="button" aria-pressed="false">Play</button>
<input type="range" min="0" max="1" value="0" aria-label="time">
<span class="clock"></span>
<select class="pace" aria-label="playback speed">{join(*paces)}</select>
<span class="group">{join(*buttons)}
<button type="button" data-zoom="0.8" aria-label="zoom in">+</button>
<button type="button" data-zoom="1.25" aria-label="zoom out">\N{MINUS SIGN}</button></span>
{follow}
<span class="note hint">drag to turn, right-drag to move, Ctrl or Shift and wheel to zoom</span>
</div>
</div>"""
    )


def _still(picture: bytes) -> Html:
    source = f"data:image/jpeg;base64,{base64.b64encode(picture).decode()}"
    return tag("img", class_="still", src=source, alt="the animal")
