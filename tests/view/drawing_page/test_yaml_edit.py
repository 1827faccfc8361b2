"""Edits of YAML texts: exactly the wanted data, and all other text unchanged."""

import copy
import json
import random
from pathlib import Path

import pytest

from evo_cpg.io.yaml_text import parse_yaml
from evo_cpg.view.drawing_page.yaml_edit import comments, equal, lost_comments, with_data

CONFIGS = sorted((Path(__file__).parents[3] / "configs").rglob("*.yaml"))

TEXT = """\
# head
a: 1        # one
b: {x: 1, y: [1, 2.50]}  # two
c:          # three
  # four
  - name: p   # five
    z: 1.0e-3
  # six
  - name: q
    z: 2

d: 'text # no comment'
"""
LONG = "a:          # one\n  long:\n    x: {y: 1}\n"


def changed(edit, text: str = TEXT) -> str:
    # Without the objects that aliases share.
    data = json.loads(json.dumps(parse_yaml(text)))
    edit(data)
    made = with_data(text, data)
    assert equal(parse_yaml(made), data)
    return made


@pytest.mark.parametrize(
    ("edit", "before", "after"),
    [
        (lambda d: d.update(a=2), "a: 1 ", "a: 2 "),
        (lambda d: d["b"].update(x=3, w=4), "{x: 1, y: [1, 2.50]}", "{x: 3, y: [1, 2.50], w: 4}"),
        (lambda d: d["b"].pop("x"), "{x: 1, y: [1, 2.50]}", "{y: [1, 2.50]}      "),
        (lambda d: d["b"].pop("y"), "{x: 1, y: [1, 2.50]}", "{x: 1}              "),
        (lambda d: d["c"][0].update(z=5), "z: 1.0e-3", "z: 5"),
        (lambda d: d["c"][0].pop("z"), "\n    z: 1.0e-3", ""),
        (lambda d: d["c"].pop(1), "\n  - name: q\n    z: 2", ""),
        (
            lambda d: d["c"].append({"name": "r", "at": [1, 2]}),
            "z: 2\n",
            "z: 2\n  - name: r\n    at: [1, 2]\n",
        ),
        (lambda d: d["c"].insert(1, {"name": "r"}), "e-3\n", "e-3\n  - name: r\n"),
        (lambda d: d.pop("d"), "\nd: 'text # no comment'", ""),
        (lambda d: d.update(e=None), "comment'\n", "comment'\ne: null\n"),
        (lambda d: d.update(a={"long": {"x": {"y": 1}}}), "a: 1        # one\n", LONG),
        (lambda d: d["c"][1].update(name="new"), "name: q", "name: new"),
    ],
)
def test_only_the_changed_value_is_edited(edit, before, after):
    assert TEXT.count(before) == 1
    assert changed(edit) == TEXT.replace(before, after)


def test_lost_comments_are_known():
    made = changed(lambda d: d["c"].pop(0))
    assert lost_comments(TEXT, made) == ["# five"]
    assert comments(TEXT) == ["# head", "# one", "# two", "# three", "# four", "# five", "# six"]


def test_an_anchor_changes_no_other_place():
    text = "a: &x {p: 1, q: 2}\nb:\n  <<: *x\n  q: 3\nc: *x  # alias\n"
    made = changed(lambda d: d["a"].update(p=5), text)
    assert made == "a: &x {p: 5, q: 2}\nb:\n  <<: *x\n  q: 3\n  p: 1\nc: {p: 1, q: 2}  # alias\n"
    made = changed(lambda d: d["b"].update(p=7), text)
    assert made == text.replace("q: 3\n", "q: 3\n  p: 7\n")
    made = changed(lambda d: d["c"].update(q=0), text)
    assert made == text.replace("c: *x", "c: {p: 1, q: 0}")


def test_a_section_without_its_anchor_is_written_anew():
    text = "a: &x [1, 2]\nb: *x\n"
    assert changed(lambda d: d.pop("a"), text) == "b: [1, 2]\n"


def _mutate(value, draw: random.Random) -> None:
    """Change, add, remove or reorder a random value inside a value."""
    news = (1, 2.5, "x: y", None, True, {}, [], {"a": [1, 2]}, [{"n": 1}, {"m": {"c": [[2]]}}])
    if isinstance(value, dict):
        key = draw.choice(list(value)) if value else "first"
        what = draw.random()
        if what < 0.2 and value:
            del value[key]
        elif what < 0.4 or not value:
            value[f"new{draw.randrange(9)}"] = copy.deepcopy(draw.choice(news))
        elif isinstance(value[key], (dict, list)) and what < 0.9:
            _mutate(value[key], draw)
        else:
            value[key] = copy.deepcopy(draw.choice(news))
    elif value:
        i, what = draw.randrange(len(value)), draw.random()
        if what < 0.15:
            del value[i]
        elif what < 0.3:
            value.insert(i, copy.deepcopy(value[i]))
        elif what < 0.4:
            draw.shuffle(value)
        elif isinstance(value[i], (dict, list)):
            _mutate(value[i], draw)
        else:
            value[i] = draw.random()


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_one_value_moves_no_other_line(path):
    text = path.read_text(encoding="utf-8")
    before, after = (made.splitlines() for made in (text, changed(_set_seed, text)))
    moved = [line for line in before if line not in after]
    assert len(moved) <= 1 and all(line.startswith("seed:") for line in moved)
    assert len(after) == len(before) + 1 - len(moved)


def _set_seed(data) -> None:
    data["seed"] = 1234567


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_random_edits_of_all_configurations_give_the_wanted_data(seed):
    for number, path in enumerate(CONFIGS):
        draw = random.Random(100 * seed + number)
        text = path.read_text(encoding="utf-8")
        data = parse_yaml(text)
        assert with_data(text, data) == text
        for _ in range(3):
            data = copy.deepcopy(data)
            _mutate(data, draw)
            text = with_data(text, data)
            assert equal(parse_yaml(text), data)
