"""YAML as configurations are written in it: what is written is what is read again."""

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from evo_cpg.config.load import as_overrides
from evo_cpg.config.yaml_text import parse_yaml, to_yaml

# Made of what numbers are made of.
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
    # Whatever reads it, were it by YAML 1.1.
    assert yaml.safe_load(to_yaml({"name": text})) == {"name": text}
    (override,) = as_overrides({"name": text})
    assert parse_yaml(override.removeprefix("name=")) == text


@given(PLAIN)
@example("a\x85b")
@example(["\u2028", "\u2029 x"])
def test_what_is_written_is_read_again(value):
    for flow in (False, True, None):
        assert parse_yaml(to_yaml({"x": value}, flow)) == {"x": value}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e3", 1000.0),
        ("-.5", -0.5),
        ("+.5E-1", 0.05),
        ("10_000", 10_000),
        ("0x1F", 31),
        ("-0", 0),
        (".inf", float("inf")),
        ("1.", 1.0),
        # Of YAML 1.1 these are 128, 100 and a date.
        ("0200", "0200"),
        ("1:40", "1:40"),
        ("2026-11-26", "2026-11-26"),
    ],
)
def test_numbers_are_those_that_a_reader_sees(text, value):
    found = parse_yaml(text)
    assert (found, type(found)) == (value, type(value))


def test_a_mapping_may_be_merged_into_one_that_is_merged():
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
def test_own_keys_count_before_merged_ones_and_these_in_their_order(merged, found):
    """As https://yaml.org/type/merge.html has it, whichever PyYAML reads."""
    text = f"a: &A {{p: 1, q: 3}}\nb: &B {{p: 2, r: 4}}\nc: {merged}\n"
    assert parse_yaml(text)["c"] == found


@pytest.mark.parametrize("merged", ["3", "[*A, 3]", "[[*A]]"])
def test_only_mappings_are_merged(merged):
    with pytest.raises(yaml.YAMLError, match="<< takes a mapping or a list of them"):
        parse_yaml(f"a: &A {{p: 1}}\nc: {{<<: {merged}}}\n")


@pytest.mark.parametrize("text", ["{a: 1, a: 2}", "[{b: {a: 1, a: 2}}]", "x: &A {a: 1, a: 2}"])
def test_a_key_that_stands_twice_is_refused(text):
    with pytest.raises(yaml.YAMLError, match="the key 'a' is given twice"):
        parse_yaml(text)
