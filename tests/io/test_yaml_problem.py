"""Messages for invalid YAML: the line, and a hint for the fix."""

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import load_config
from evo_cpg.io.yaml_text import parse_yaml, syntax_problem

TEXT = """name: tiny
creature:
  name: tiny
  materials: {flesh: {density: 1000}}
  bodies:
    - name: head
      shape: {type: box, size: [0.2, 0.1, 0.1]}
      material: flesh
      color: '#ffffff'
    - name: tail
      material: flesh
"""


def message(tmp_path, text: str | bytes, *overrides: str) -> str:
    """Return the error message for a file, which must fit on one line."""
    path = tmp_path / "x.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError) as caught:
        load_config(path, overrides)
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix(f"{path}: ")


@pytest.mark.parametrize(
    ("old", "new", "place", "hint"),
    [
        ("  name: tiny", "\tname: tiny", "line 3, column 1", "A tab stands at the beginning"),
        (
            "      material: flesh\n      c",
            "\tmaterial: flesh\n      c",
            "line 8, column 1",
            "A tab",
        ),
        ("      color", "    \t color", "line 9, column 5", "A tab stands at the beginning"),
        ("name: tail", "name: {side}_fin", "line 10", "with braces in quotes: '{side}_fin'"),
        ("name: tail", "name: {i}{j}", "line 10", "with braces in quotes: '{i}{j}'"),
        ("name: tail", "names: [{side}_fin, x]", "line 10", "in quotes: '{side}_fin'"),
        ("name: tail", "eye: {body: fin_{side}}", "line 10", "in quotes: 'fin_{side}'"),
        ("name: tail", "name: *tail", "line 10", "YAML reserves * at the beginning of a value"),
        ("name: tail", "legs: [*_leg, x]", "line 10", "Write it in quotes: '*_leg'"),
        ("name: tail", "name: %tail", "line 10", "Write it in quotes: '%tail'"),
        ("name: tail", "name: @tail", "line 10", "Write it in quotes: '@tail'"),
        ("name: tail", "name: `tail`", "line 10", "Write it in quotes: '`tail`'"),
        ("name: tail", "name: !tail", "line 10", "Write it in quotes: '!tail'"),
        ("name: tail", "name: tail: left", "line 10", "contains a colon and a space in quotes"),
        ("name: tail", "name:tail", "line 11", "A space is missing after the colon in line 10"),
        ("- name: tail", "-name: tail", "line 10", "A space is missing after the - in line 10"),
        (
            "      color",
            "        color",
            "line 9",
            "The line is indented by 8 characters, line 8 by 6",
        ),
        (
            "      color",
            "     color",
            "line 9",
            "The line is indented by 5 characters, line 8 by 6",
        ),
        ("name: tail", "name:\xa0tail", "line 11", "The character U+00A0 looks like a space"),
        ("name: tail", "name: 'tail", "line 12", "The quote that opens in line 10 is not closed"),
        (
            "size: [0.2, 0.1, 0.1]",
            "size: [0.2, 0.1, 0.1",
            "line 7",
            "The [ in line 7 is not closed",
        ),
        ("{density: 1000}}", "{density: 1000}", "line 5", "The { in line 4 is not closed"),
        ("[0.2, 0.1, 0.1]}", "[0.2, 0.1 # long", "line 8", "A # after a space begins a comment"),
        ("name: tail", "name: tail\n---", "line 11", "Leave out '---'"),
        ("name: tail", "name: ta\x07il", "line 10, column 15", "control characters"),
    ],
)
def test_invalid_yaml_gets_a_hint(tmp_path, old, new, place, hint):
    problem = message(tmp_path, TEXT.replace(old, new, 1))
    assert problem.startswith(place)
    assert "not valid YAML: " in problem and hint in problem


def test_a_colour_without_quotes_is_refused(tmp_path):
    """YAML reads it as a comment, which would silently select the default colour."""
    text = TEXT.replace("'#ffffff'", "#ffffff")
    words = (
        "line 9: color: the value is missing, since # begins a comment. Write the color in quotes"
    )
    assert message(tmp_path, text).startswith(f"{words}: '#ffffff'")
    assert parse_yaml(text)["creature"]["bodies"][0]["color"] is None
    commented = TEXT.replace("      color: '#ffffff'", "      # color: #ffffff")
    assert "color" not in message(tmp_path, commented).split(": ")[1]


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (TEXT.replace("tail", "schw\xe4nzchen").encode("latin1"), "in line 10). Save it as UTF-8"),
        (TEXT.encode("utf-16"), "(byte 0 is wrong, in line 1). Save it as UTF-8"),
    ],
)
def test_wrong_encoding_is_reported_with_its_line(tmp_path, text, place):
    assert place in message(tmp_path, text)


@pytest.mark.parametrize(
    "change", [lambda t: b"\xef\xbb\xbf" + t, lambda t: t.replace(b"\n", b"\r\n")]
)
def test_other_line_ends_and_a_byte_order_mark_are_accepted(tmp_path, change):
    """The only error is the missing shape, reported in its line."""
    assert message(tmp_path, change(TEXT.encode())).startswith("line 10: creature.bodies.1.shape")


@given(st.text("ab{}[]:,-'\"*&!%@`#|>?\t\n\r \x85\u2028\x07", max_size=30))
@example("name: x\nb: [\n")
@example("a: {b: [\n\n")
@example("a: '\n")
@example("\r\r- [")
def test_every_syntax_error_fits_on_one_line(text):
    try:
        parse_yaml(text)
    except yaml.YAMLError as error:
        place, problem = syntax_problem(text, error)
        assert place.startswith("line ") and problem
        assert not {"\n", "\r"} & set(problem)


@pytest.mark.parametrize(
    ("override", "hint"),
    [
        ("creature.bodies.1.name={side}_fin", "Write text with braces in quotes: '{side}_fin'"),
        ("controller.groups={legs: [*_leg]}", "Write it in quotes: '*_leg'"),
    ],
)
def test_invalid_yaml_in_an_override_gets_a_hint(tmp_path, override, hint):
    problem = message(tmp_path, TEXT, override)
    assert problem.startswith(f"command line: {override.split('=')[0]}: ")
    assert "is not YAML: " in problem and hint in problem
