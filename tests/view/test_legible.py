"""Names in any script can be read in every picture."""

import dataclasses

import numpy as np
import pytest
import synthetic

from evo_cpg.view.figure import save_figure
from evo_cpg.view.legible import legible, lettering, write
from evo_cpg.view.plots import joint_signals_figure
from evo_cpg.view.preview import preview
from pictures import ink

NAMES = ("頭部", "хвост", "ουρά", "🐟😀", "あタマ", "머리", "b$7$", "é_ß", "सिर", "尾")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("segment{i} $x$", "segment{i} $x$"),
        ("хвост ουρά é", "хвост ουρά é"),
        ("e\u0301", "é"),
        ("頭a", "<982D>a"),
        ("あタマ", "atama"),
        ("머리", "meori"),
        ("🐟", "(fish)"),
        ("सिर", "sara"),
        ("\ue000", "<E000>"),
    ],
)
def test_missing_characters_are_spelt_out(text, expected):
    assert legible(text) == expected


def drawn(text):
    """Pixels of a text, light on dark."""
    picture = np.zeros((60, 240, 3), np.uint8)
    with lettering(picture) as draw:
        write(draw, text, (10, 40), 24, "white")
    return picture.mean(-1)


def test_a_picture_shows_every_letter():
    """More letters are wider. Missing glyphs would all be drawn as equal boxes."""
    for text in NAMES:
        shown = [drawn(text[:count]) > 100 for count in (1, len(text))]
        widths = [np.ptp(np.flatnonzero(image.any(0))) for image in shown]
        assert widths[0] > 3 and (widths[1] > widths[0] or len(text) == 1), text
    assert len({drawn(text).tobytes() for text in NAMES}) == len(NAMES)


def test_words_stand_at_their_anchor():
    """Anchors follow Pillow. A plate lies behind the letters."""
    picture = np.zeros((60, 240, 3), np.uint8)
    with lettering(picture) as draw:
        write(draw, "x", (120, 30), 20, "#ff0000", anchor="mm", plate="#0000ff")
    rows, columns = np.nonzero(picture[..., 0] > 200)
    assert (columns.mean(), rows.mean()) == pytest.approx((120, 30), abs=3)
    assert ((picture[..., 2] > 150) & (picture[..., 0] == 0)).sum() > 100


@pytest.mark.slow
def test_names_of_an_animal_may_be_in_any_script(tmp_path):
    """No glyph is missing: matplotlib would warn, and a warning is an error here."""
    creature, motion = synthetic.swimmer(), synthetic.swim(12)
    new = {body.name: name for body, name in zip(creature.bodies, NAMES, strict=True)}
    bodies = [
        dataclasses.replace(
            body,
            name=new[body.name],
            joint=body.joint and dataclasses.replace(body.joint, parent=new[body.joint.parent]),
        )
        for body in creature.bodies
    ]
    eyes = tuple(dataclasses.replace(eye, body=NAMES[0]) for eye in creature.light_sensors)
    other = dataclasses.replace(
        creature, name="魚", bodies=tuple(bodies), light_sensors=eyes, pressure_sensors=()
    )
    plain = preview(creature, tmp_path / "plain.png", (320, 180))
    named = preview(other, tmp_path / "body.png", (320, 180))
    # Only the words on the animal differ.
    changed = np.abs(synthetic.read(named) - synthetic.read(plain)).max(-1) > 60
    assert 0.005 < changed.mean() < 0.1
    parts = [name.rpartition(".") for name in motion.dof_names]
    moving = motion._replace(dof_names=tuple(f"{new[body]}.{axis}" for body, _, axis in parts))
    figure = joint_signals_figure(moving, title="魚 $x$")
    assert ink(save_figure(figure, tmp_path / "joints.png")) > 0.02
    assert figure.get_suptitle().startswith("<9B5A> $x$: joint signals")
