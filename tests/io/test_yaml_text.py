"""Reading and writing of YAML: written values are read back unchanged."""

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from evo_cpg.io.load import as_overrides
from evo_cpg.io.yaml_text import lost_colour, parse_yaml, syntax_problem, to_yaml

# Text from the characters of numbers.
NUMBERLIKE = st.text("-+0123456789.eE_:x", min_size=1, max_size=8)
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | NUMBERLIKE | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text() | NUMBERLIKE, inner),
    max_leaves=6,
)


@given(NUMBERLIKE)
@example("1e3")
@example("2E5")
@example(".5e3")
@example("0200")
@example("1:40")
@example("-.5")
@example("2026-11-26")
def test_text_that_looks_like_a_number_stays_text(text):
    assert parse_yaml(to_yaml({"name": text, text: 1})) == {"name": text, text: 1}
    # A YAML 1.1 reader also reads it as text.
    assert yaml.safe_load(to_yaml({"name": text})) == {"name": text}
    (override,) = as_overrides({"name": text})
    assert parse_yaml(override.removeprefix("name=")) == text


@given(PLAIN)
@example("a\x85b")
@example(["\u2028", "\u2029 x"])
def test_written_values_are_read_back(value):
    for flow in (False, True, None):
        assert parse_yaml(to_yaml({"x": value}, flow)) == {"x": value}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e3", 1000.0),
        ("-.5", -0.5),
        ("+.5E-1", 0.05),
        ("1.e-3", 0.001),
        ("+1e-3", 0.001),
        ("10_000", 10_000),
        ("0x1F", 31),
        ("-0", 0),
        (".inf", float("inf")),
        ("1.", 1.0),
        # YAML 1.1 reads these as 128, 100 and a date.
        ("0200", "0200"),
        ("1:40", "1:40"),
        ("2026-11-26", "2026-11-26"),
    ],
)
def test_numbers_are_read_as_they_look(text, value):
    found = parse_yaml(text)
    assert (found, type(found)) == (value, type(value))


def test_merges_can_be_nested():
    text = "x: &B {p: 1}\no: {a: &A {<<: *B, p: 2}}\nc: {<<: *A}\n"
    assert parse_yaml(text)["c"] == {"p": 2}


@pytest.mark.parametrize(
    ("merged", "found"),
    [
        ("{<<: *A, q: 5}", {"p": 1, "q": 5}),
        ("{q: 5, <<: *A}", {"p": 1, "q": 5}),
        ("{<<: [*A, *B]}", {"p": 1, "q": 3, "r": 4}),
        ("{<<: [*B, *A]}", {"p": 2, "q": 3, "r": 4}),
        ("{<<: []}", {}),
    ],
)
def test_own_keys_override_merged_keys(merged, found):
    """Earlier mappings override later ones (https://yaml.org/type/merge.html)."""
    text = f"a: &A {{p: 1, q: 3}}\nb: &B {{p: 2, r: 4}}\nc: {merged}\n"
    assert parse_yaml(text)["c"] == found


@pytest.mark.parametrize("merged", ["3", "[*A, 3]", "[[*A]]"])
def test_only_mappings_are_merged(merged):
    with pytest.raises(yaml.YAMLError, match="mapping"):
        parse_yaml(f"a: &A {{p: 1}}\nc: {{<<: {merged}}}\n")


@pytest.mark.parametrize("text", ["{a: 1, a: 2}", "[{b: {a: 1, a: 2}}]", "x: &A {a: 1, a: 2}"])
def test_duplicate_key_is_rejected(text):
    with pytest.raises(yaml.YAMLError, match="the key 'a' is given twice"):
        parse_yaml(text)


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


def test_a_colour_without_quotes_is_found():
    """YAML reads it as a comment, which would silently select the default colour."""
    assert "line 2" in (lost_colour("a: 1\n  color: #ffffff\n") or "")
    for text in ("color: '#ffffff'", "# color: #ffffff", "color: red"):
        assert lost_colour(text) is None
