"""ProposedEdit the data of a YAML text, and keep the rest of the text.

`with_data` gives the text without its comments to ruamel.yaml, which keeps anchors, brackets and
number formats, and changes the values that differ. The lines that ruamel.yaml then writes
differently go back into the text, so that all other lines and all comments stay as they are. The
result is parsed again. It always contains exactly the changed data, because the whole text is
written anew if a part cannot be edited.
"""

import difflib
import io
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

import yaml
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError
from ruamel.yaml.representer import RoundTripRepresenter
from ruamel.yaml.scalarstring import DoubleQuotedScalarString, SingleQuotedScalarString

from evo_cpg.io.yaml_text import parse_yaml, to_yaml

# Longest collection that is written with brackets in a line, characters.
_LINE = 76
# A list whose dashes are below the first letter of its key.
_FLUSH = re.compile(r"^( *)[^\s#-].*:\n\1- ", re.MULTILINE)
_QUOTED = {"'": SingleQuotedScalarString, '"': DoubleQuotedScalarString}


class _Representer(RoundTripRepresenter):
    """Representer that writes null in words, because a value that is left out looks forgotten."""


_Representer.add_representer(
    type(None), lambda own, _: own.represent_scalar("tag:yaml.org,2002:null", "null")
)


def with_data(text: str, data: Any) -> str:
    """Return a YAML text with the given data, changed as little as possible.

    Args:
        text: YAML text, valid, with line feeds as ends of lines.
        data: text, numbers, booleans, None, and lists and mappings of them.

    Raises:
        ValueError: no configuration can contain the data, such as a NaN or very deep lists.
    """
    old = parse_yaml(text)
    if equal(old, data):
        return text
    problem = "it is not read as it is written"
    for edited in _edited(text, old, data):
        try:
            if equal(parse_yaml(edited), data):
                return edited
        except yaml.YAMLError as error:
            problem = str(getattr(error, "problem", None) or error)
    raise ValueError(f"no configuration can contain this value ({problem})")


def _edited(text: str, old: Any, data: Any) -> Iterator[str]:
    """Yield texts that should contain the data, from the least change to a new text."""
    remarks, touched = _scanned(text)
    starts = {line: column for line, column, _ in remarks}
    lines = text.split("\n")
    code = [lines[i][: starts[i]].rstrip() if i in starts else lines[i] for i in touched]
    form = YAML()
    form.Representer = _Representer
    form.preserve_quotes, form.width = True, 10**9
    offset = 0 if _FLUSH.search("\n".join(code)) else 2
    form.indent(sequence=offset + 2, offset=offset)
    try:
        root = form.load("\n".join(code))
        before = _written(form, root)
        after = _written(form, _changed(root, old, data, {}))
    except (YAMLError, AttributeError, LookupError, TypeError, ValueError):
        pass
    else:
        # Numbers of the lines that each line by ruamel.yaml stands for, which joins lists.
        one, other = ([" ".join(line.split()) for line in rows] for rows in (code, before))
        sources: list[list[int]] = [[] for _ in before]
        for _, i, i_end, j, j_end in _differences(one, other):
            for k in range(i_end - i):
                # Lines that have no counterpart belong to the one before.
                sources[max(min(j + k, j_end - 1), 0)].append(touched[i + k])
        for keeps in (True, False):
            yield _carried(lines, sources, before, after, starts, keeps)
    yield "\n".join(_written(form, _styled(data))) + "\n"


def comments(text: str) -> list[str]:
    """Return the comments of a YAML text, in order, from their # on."""
    return [words for _, _, words in _scanned(text)[0]]


def lost_comments(before: str, after: str) -> list[str]:
    """Return the comments of one text that another text lacks."""
    return list((Counter(comments(before)) - Counter(comments(after))).elements())


def equal(one: Any, other: Any) -> bool:
    """Return whether two values are the same YAML data. 1 and 1.0 are, 1 and true are not."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(equal, one, other))
    return isinstance(one, bool) == isinstance(other, bool) and bool(one == other)


def _scanned(text: str) -> tuple[list[tuple[int, int, str]], list[int]]:
    """Return the comments of a text with their lines and columns, and the lines that hold more."""
    remarks, touched, end = [], set(), None
    for token in yaml.scan(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
        start = token.start_mark
        gap = text[end.index if end else 0 : start.index]
        for i, part in enumerate(gap.split("\n")):
            found = re.search("#.*", part)
            if found:
                column = found.start() + (end.column if end and i == 0 else 0)
                remarks.append((i + (end.line if end else 0), column, found[0].rstrip()))
        if end is None or token.end_mark.index >= end.index:
            end = token.end_mark
        # A block of text ends at the start of the next line.
        last = token.end_mark.line - (token.end_mark.column == 0)
        if token.end_mark.index > start.index:
            touched.update(range(start.line, last + 1))
    return remarks, sorted(touched)


def _written(form: YAML, data: Any) -> list[str]:
    """Return the lines of some data, without the end of the last line."""
    stream = io.StringIO()
    form.dump(data, stream)
    return stream.getvalue().removesuffix("\n").split("\n")


def _changed(node: Any, old: Any, new: Any, seen: dict[int, Any]) -> Any:
    """Return the node of a changed value: the same one, or another one in its place.

    Args:
        node: node of ruamel.yaml, which is changed.
        old: its data.
        new: the wanted data.
        seen: wanted data of the collections so far. A node that comes again is an alias.
    """
    if id(node) in seen:
        return node if equal(seen[id(node)], new) else _styled(new)
    whole = isinstance(node, (CommentedMap, CommentedSeq))
    if not whole or not old or not new or type(old) is not type(new):
        return node if equal(old, new) else _styled(new)
    if node.fa.flow_style() and _is_nested(new) and not _is_nested(old):
        return _styled(new)  # It needs lines of its own.
    seen[id(node)] = new
    if isinstance(node, CommentedSeq):
        pairs = list(_pairs(old, new))
        entries = [
            _styled(new[j], True) if i is None else _changed(node[i], old[i], new[j], seen)
            for j, i in enumerate(pairs)
        ]
        list.__setitem__(node, slice(None), entries)
        return node
    own = [key for key, _ in node.non_merged_items()]
    inherited = {}
    for merged in reversed(list(node.merge)):
        inherited |= seen.get(id(merged), {})
    if any(key not in new for key in inherited):
        return _styled(new)
    for key in [key for key in own if key not in new]:
        del node[key]
    order = [key for key in own if key in new]
    last = None
    for key, value in new.items():
        if key in own:
            made = _changed(node[key], old[key], value, seen)
            if made is not node[key]:
                node[key] = made
        elif key in inherited and equal(inherited[key], value):
            continue
        else:
            node[key] = _styled(value)
            order.insert(order.index(last) + 1 if last in order else len(order), key)
        last = key
    for key in order:
        node.move_to_end(key)
    return node


def _pairs(old: list, new: list) -> Iterator[int | None]:
    """Yield for each new entry the index of the old entry that it continues, or None."""

    def identity(entry: Any) -> str:
        named = isinstance(entry, dict) and "name" in entry
        return f"name: {entry['name']}" if named else repr(entry)

    names, later = list(map(identity, old)), list(map(identity, new))
    if len(old) == len(new) and Counter(names) != Counter(later):
        yield from range(len(old))
        return
    left = defaultdict(list)
    for i, name in enumerate(names):
        left[name].append(i)
    for name in later:
        yield left[name].pop(0) if left[name] else None


def _styled(value: Any, is_entry: bool = False) -> Any:
    """Return new data for ruamel.yaml: quoted as PyYAML needs, and short collections in brackets.

    Args:
        value: the data.
        is_entry: whether the value is an entry of a list. Mappings there have lines of their own.
    """
    words = to_yaml([value], flow=True).strip()[1:-1]
    if isinstance(value, str) and words[:1] in _QUOTED:
        return _QUOTED[words[0]](value)
    if not isinstance(value, (dict, list)):
        return value
    made: Any = CommentedSeq()
    if isinstance(value, dict):
        made = CommentedMap((_styled(key), _styled(inner)) for key, inner in value.items())
    else:
        made.extend(_styled(inner, True) for inner in value)
    is_open = len(words) > _LINE or _is_nested(value) or (is_entry and isinstance(value, dict))
    if value and is_open:
        made.fa.set_block_style()
    else:
        made.fa.set_flow_style()
    return made


def _is_nested(value: Any) -> bool:
    """Return whether a value is a mapping that contains mappings, or lists of collections."""
    return isinstance(value, dict) and any(
        isinstance(inner, dict)
        or (isinstance(inner, list) and any(isinstance(x, (list, dict)) for x in inner))
        for inner in value.values()
    )


def _carried(
    lines: list[str],
    sources: list[list[int]],
    before: list[str],
    after: list[str],
    starts: dict[int, int],
    keeps: bool,
) -> str:
    """Return a text with the lines that ruamel.yaml writes differently after the change.

    Args:
        lines: lines of the text.
        sources: numbers of the lines that each line before stands for.
        before: lines that ruamel.yaml writes of the data before the change.
        after: lines that it writes after the change.
        starts: columns of comments by line.
        keeps: whether lines that do not change keep their form. If not, they are written anew, as
            the new lines may be indented differently.
    """
    placed: dict[int, list[str]] = defaultdict(list)
    gone, last = set(), -1
    hunks: list[tuple[str, int, int, int, int]] = []
    for what, i, i_end, j, j_end in _differences(before, after):
        if what == "equal":
            hunks.append((what, i, i_end, j, j_end))
            continue
        # Replaced lines with the same key stand in one hunk.
        changed = before[i:i_end], after[j:j_end]
        keys, later = ([line.partition(":")[0] for line in rows] for rows in changed)
        for _, k, k_end, m, m_end in _differences(keys, later):
            hunks.append(("replace", i + k, i + k_end, j + m, j + m_end))
    for what, i, i_end, j, j_end in hunks:
        for k in range(max(i_end - i, j_end - j)):
            own = sources[i + k] if i + k < i_end else []
            last = own[-1] if own else last
            if what == "equal" and keeps:
                continue
            gone.update(own)
            if j + k < j_end:
                line, start = after[j + k], starts.get(last) if own else None
                if start is not None:
                    line = f"{line}  ".ljust(start) + lines[last][start:]
                placed[last].append(line)
    made = placed[-1]
    for number, line in enumerate(lines):
        made += [*([] if number in gone else [line]), *placed[number]]
    return "\n".join(made)


def _differences(one: list[str], other: list[str]) -> Sequence[tuple[str, int, int, int, int]]:
    return difflib.SequenceMatcher(None, one, other, autojunk=False).get_opcodes()
