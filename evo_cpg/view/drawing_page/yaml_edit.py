"""Change the data of a YAML text, and keep the rest of the text.

`with_data` compares the data of a text with changed data. It edits only the lines of values that
differ, so comments, anchors, layout and number formats stay elsewhere. The result is parsed again.
It always contains exactly the changed data, because a part that cannot be edited is written anew.
"""

import difflib
import re
from collections import Counter
from typing import Any

import yaml

from evo_cpg.io.yaml_text import compose_yaml, parse_yaml, to_yaml

# Longest collection that is written with brackets in a line, characters.
_LINE = 76
# An edit under an anchor changes the places of its aliases, too. The next pass corrects them.
_PASSES = 4
_MISSING = object()
# A colon and an alias.
_ALIAS = re.compile(r"\s*:\s*(\*[^\s,\]}]+)")


class _UnplacedError(Exception):
    """Raised if a value has no place of its own in the text."""


def with_data(text: str, data: Any) -> str:
    """Return a YAML text with the given data, changed as little as possible.

    Args:
        text: YAML text, valid, with line feeds as ends of lines.
        data: text, numbers, booleans, None, and lists and mappings of them.

    Raises:
        ValueError: no configuration can contain the data, such as a NaN or very deep lists.
    """
    edited, now = text, parse_yaml(text)
    for _ in range(_PASSES):
        if equal(now, data):
            return edited
        try:
            edited = _Editor(edited).change(now, data)
            now = parse_yaml(edited)
        except (_UnplacedError, yaml.YAMLError):
            break
    return _rewritten(text, data)


def comments(text: str) -> list[str]:
    """Return the comments of a YAML text, in order, from their # on."""
    found, end = [], 0
    for token in yaml.scan(text, yaml.CSafeLoader if hasattr(yaml, "CSafeLoader") else yaml.Loader):
        found += re.findall(r"#.*", text[end : token.start_mark.index])
        end = max(end, token.end_mark.index)
    return [comment.rstrip() for comment in found]


def lost_comments(before: str, after: str) -> list[str]:
    """Return the comments of one text that another text lacks."""
    left = Counter(comments(after))
    lost = []
    for comment in comments(before):
        left[comment] -= 1
        if left[comment] < 0:
            lost.append(comment)
    return lost


def equal(one: Any, other: Any) -> bool:
    """Return whether two values are the same YAML data. 1 and 1.0 are, 1 and true are not."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(equal, one, other))
    return isinstance(one, bool) == isinstance(other, bool) and bool(one == other)


class _Editor:
    """Edits of one text, which are collected and then applied together."""

    def __init__(self, text: str):
        self.text, self.lines = text, text.split("\n")
        self.edits: list[tuple[int, int, str]] = []
        # Place of the first occurrence of each node. Its other places are aliases.
        self.places: dict[int, tuple] = {}

    def change(self, old: Any, new: Any) -> str:
        root = compose_yaml(self.text)
        if not isinstance(root, yaml.MappingNode) or not isinstance(new, dict):
            raise _UnplacedError
        self._note((), root)
        self._value((), root, old, new, _Place(0, False))
        text = self.text
        # From the end of the text, so that positions stay valid. Later insertions at one position
        # stand behind earlier ones.
        order = sorted(range(len(self.edits)), key=lambda i: (*self.edits[i][:2], i), reverse=True)
        for start, end, words in (self.edits[i] for i in order):
            text = text[:start] + words + text[end:]
        return text

    def _note(self, path: tuple, node: yaml.Node) -> None:
        if id(node) in self.places:
            return
        self.places[id(node)] = path
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                self._note((*path, key.value), value)
        elif isinstance(node, yaml.SequenceNode):
            for i, value in enumerate(node.value):
                self._note((*path, i), value)

    def _value(self, path: tuple, node: yaml.Node, old: Any, new: Any, place: "_Place") -> None:
        if equal(old, new):
            return
        if self._is_alias(path, node):
            # An edit of the anchored value would change the anchor, so the alias is replaced.
            start, end = self._alias(place)
            self.edits.append((start, end, _inline(new)))
            return
        before = len(self.edits)
        try:
            # An empty collection has no line of its own.
            in_line = isinstance(node, yaml.CollectionNode) and node.flow_style and not place.flow
            if in_line and _is_nested(new) and not _is_nested(old):
                self._replace(path, node, new, place)  # It needs lines of its own.
            elif isinstance(node, yaml.MappingNode) and isinstance(new, dict) and old and new:
                self._mapping(path, node, old, new, place)
            elif isinstance(node, yaml.SequenceNode) and isinstance(new, list) and old and new:
                self._sequence(path, node, old, new, place)
            else:
                self._replace(path, node, new, place)
        except _UnplacedError:
            del self.edits[before:]
            self._replace(path, node, new, place)

    def _is_alias(self, path: tuple, node: yaml.Node) -> bool:
        return self.places[id(node)] != path

    def _alias(self, place: "_Place") -> tuple[int, int]:
        """Return start and end of the alias that is the value of a key."""
        found = place.after is not None and _ALIAS.match(self.text, place.after)
        if not found:
            raise _UnplacedError
        return found.span(1)

    def _mapping(
        self, path: tuple, node: yaml.MappingNode, old: dict, new: dict, place: "_Place"
    ) -> None:
        pairs = {key.value: (key, value) for key, value in node.value}
        gone = [key for key in old if key not in new]
        if not set(gone) <= set(pairs):
            raise _UnplacedError  # An inherited key cannot be left out.
        if set(gone) == set(pairs):
            self._replace(path, node, new, place)
            return
        flow = bool(node.flow_style) or place.flow
        column = node.value[0][0].start_mark.column
        # A key that was inherited by << gets a line of its own, too.
        added = {
            key: value
            for key, value in new.items()
            if key not in pairs and not equal(old.get(key, _MISSING), value)
        }
        leading, end, ends = True, node.start_mark.index, {}
        for i, (key, value) in enumerate(node.value):
            start = key.start_mark.index
            inner = _Place(column, flow, key.end_mark.index)
            own_end = self._end((*path, key.value), value, inner)
            ends[key.value] = own_end
            if key.value in gone:
                following = node.value[i + 1 :] and node.value[i + 1][0].start_mark.index
                self._remove(start, own_end, flow, None if leading else end, following)
            else:
                leading = False
                if key.value in new and key.value in old:
                    self._value((*path, key.value), value, old[key.value], new[key.value], inner)
            end = own_end
        # A key is added behind the key that it follows in the changed data, if that stays.
        behind: dict[str, dict[str, Any]] = {}
        last, stays = "", {key.value for key, _ in node.value if key.value not in gone}
        for key, value in new.items():
            if key in added:
                behind.setdefault(last, {})[key] = value
            elif key in stays:
                last = key
        for before, group in behind.items():
            after = ends.get(before, end)
            if flow:
                words = "".join(f", {_inline(key)}: {_inline(x)}" for key, x in group.items())
                self.edits.append((after, after, words))
            else:
                at, indent = self._line_end(after), " " * column
                lines = [f"\n{indent}{_pair(key, x, column)}" for key, x in group.items()]
                self.edits.append((at, at, "".join(lines)))

    def _sequence(
        self, path: tuple, node: yaml.SequenceNode, old: list, new: list, place: "_Place"
    ) -> None:
        steps = _steps(old, new)
        if all(step[0] != "keep" for step in steps):
            self._replace(path, node, new, place)
            return
        flow = bool(node.flow_style) or place.flow
        column = node.start_mark.column
        indent = " " * column
        leading, end = True, node.start_mark.index
        for what, i, j in steps:
            if what == "add":
                words = _inline(new[j]) if flow else f"- {_block(new[j], column + 2)}"
                if leading:
                    # Before the first entry.
                    start = node.value[0].start_mark.index if flow else self._dash(node, 0)
                    self.edits.append(
                        (start, start, f"{words}, " if flow else f"{words}\n{indent}")
                    )
                elif flow:
                    self.edits.append((end, end, f", {words}"))
                else:
                    at = self._line_end(end)
                    self.edits.append((at, at, f"\n{indent}{words}"))
                continue
            value = node.value[i]
            own_end = self._end((*path, i), value, _Place(column, flow))
            if what == "remove":
                start = value.start_mark.index if flow else self._dash(node, i)
                following = 0
                if i + 1 < len(node.value):
                    after = node.value[i + 1].start_mark.index
                    following = after if flow else self._dash(node, i + 1)
                self._remove(start, own_end, flow, None if leading else end, following)
            else:
                leading = False
                self._value((*path, i), value, old[i], new[j], _Place(column, flow))
            end = own_end

    def _remove(self, start: int, end: int, flow: bool, before: int | None, after: Any) -> None:
        """Remove an entry of a collection.

        Args:
            start: start of the entry.
            end: end of the entry.
            flow: whether the collection is in brackets.
            before: end of the entry before it, or None if no entry stays before it.
            after: start of the entry after it.
        """
        line = self.text.rfind("\n", 0, start) + 1
        if not flow and not self.text[line:start].strip():
            # Whole lines, without comments above and below.
            stop = self._line_end(end)
            self.edits.append((line - 1, stop, "") if line else (0, stop + 1, ""))
        elif before is None:
            self.edits.append((start, after, ""))
        else:
            self.edits.append((before, end, ""))

    def _replace(self, path: tuple, node: yaml.Node, new: Any, place: "_Place") -> None:
        """Write a value anew, in place of the text of a node."""
        start, end = node.start_mark.index, self._end(path, node, place)
        block = isinstance(node, yaml.CollectionNode) and not node.flow_style
        if isinstance(node, yaml.ScalarNode) and node.style in ("|", ">"):
            block, end = True, start + len(self.text[start:end].rstrip())
        words = _inline(new)
        if place.flow or not _is_long(new, words):
            if block and place.after is not None:
                start = self.text.index(":", place.after) + 1
                words = f" {words}"
        elif place.after is not None:
            start = self.text.index(":", place.after) + 1
            inner = place.column + 2
            words = f"\n{' ' * inner}{_block(new, inner)}"
        else:
            words = _block(new, place.column + 2)
        if start == end and not words.startswith((" ", "\n")):
            words = f" {words}"
        anchor = re.match(r"&\S+[ ]*", self.text[node.start_mark.index :])
        if anchor and start == node.start_mark.index:
            start += len(anchor[0])
            words = f" {words}" if not anchor[0].endswith(" ") else words
        elif anchor:
            raise _UnplacedError
        self.edits.append((start, end, words))

    def _end(self, path: tuple, node: yaml.Node, place: "_Place") -> int:
        """Return the end of a value's text, without the lines after it."""
        if self._is_alias(path, node):
            return self._alias(place)[1]
        if node.value and isinstance(node, yaml.MappingNode) and not node.flow_style:
            key, value = node.value[-1]
            inner = _Place(key.start_mark.column, False, key.end_mark.index)
            return max(key.end_mark.index, self._end((*path, key.value), value, inner))
        if node.value and isinstance(node, yaml.SequenceNode) and not node.flow_style:
            last = len(node.value) - 1
            return self._end((*path, last), node.value[last], _Place(0, False))
        return node.end_mark.index

    def _line_end(self, position: int) -> int:
        """Return the end of the line of a position, before its line feed."""
        if position and self.text[position - 1] == "\n":
            return position - 1  # The text of a block scalar includes its last line feed.
        end = self.text.find("\n", position)
        return len(self.text) if end < 0 else end

    def _dash(self, node: yaml.SequenceNode, i: int) -> int:
        """Return the position of the dash of an entry."""
        column, line = node.start_mark.column, node.value[i].start_mark.line
        while self.lines[line][column : column + 1] != "-":
            line -= 1
            if line < 0:
                raise _UnplacedError
        return sum(len(each) + 1 for each in self.lines[:line]) + column


class _Place:
    """The surroundings of a value.

    Attributes:
        column: column of its key, or of its dash.
        flow: whether it is inside brackets.
        after: end of its key, or None for an entry of a list.
    """

    def __init__(self, column: int, flow: bool, after: int | None = None):
        self.column, self.flow, self.after = column, flow, after


def _steps(old: list, new: list) -> list[tuple[str, int, int]]:
    """Return how one list becomes another: entries to keep (and change), remove and add."""
    names, later = list(map(_identity, old)), list(map(_identity, new))
    if len(old) == len(new) and Counter(names) != Counter(later):
        return [("keep", i, i) for i in range(len(old))]
    steps: list[tuple[str, int, int]] = []
    matcher = difflib.SequenceMatcher(None, names, later, autojunk=False)
    for what, i, i_end, j, j_end in matcher.get_opcodes():
        both = min(i_end - i, j_end - j) if what in ("equal", "replace") else 0
        steps += [("keep", i + k, j + k) for k in range(both)]
        steps += [("remove", k, -1) for k in range(i + both, i_end)]
        steps += [("add", -1, k) for k in range(j + both, j_end)]
    return steps


def _identity(entry: Any) -> str:
    """Return the text by which an entry of a list is recognised."""
    return f"name: {entry['name']}" if isinstance(entry, dict) and "name" in entry else repr(entry)


def _inline(value: Any) -> str:
    return to_yaml([value], flow=True).strip()[1:-1]


def _is_long(value: Any, words: str) -> bool:
    """Return whether a value is a collection that needs lines of its own."""
    whole = isinstance(value, (dict, list)) and bool(value)
    return whole and (len(words) > _LINE or _is_nested(value))


def _is_nested(value: Any) -> bool:
    """Return whether a value is a mapping that contains mappings, or lists of collections."""
    return isinstance(value, dict) and any(
        isinstance(inner, dict)
        or (isinstance(inner, list) and any(isinstance(x, (list, dict)) for x in inner))
        for inner in value.values()
    )


def _block(value: Any, column: int) -> str:
    """Return a value whose first line begins at a column, and other lines below it."""
    words = _inline(value)
    if not isinstance(value, (dict, list)) or not value:
        return words
    indent = "\n" + " " * column
    if isinstance(value, dict):
        return indent.join(_pair(key, inner, column) for key, inner in value.items())
    if not _is_long(value, words):
        return words
    return indent.join(f"- {_block(inner, column + 2)}" for inner in value)


def _pair(key: Any, value: Any, column: int) -> str:
    words = _inline(value)
    if not _is_long(value, words):
        return f"{_inline(key)}: {words}"
    return f"{_inline(key)}:\n{' ' * (column + 2)}{_block(value, column + 2)}"


def _rewritten(text: str, data: dict[str, Any]) -> str:
    """Write each section anew that differs, or the whole text if sections share anchors."""
    edited = text
    try:
        for key, value in data.items():
            now = parse_yaml(edited)
            if not equal(now.get(key, _MISSING), value):
                without = {name: each for name, each in now.items() if name != key}
                edited = _Editor(edited).change(now, without) if key in now else edited
                edited = edited.rstrip("\n") + f"\n{_pair(key, value, 0)}\n"
        now = parse_yaml(edited)
        kept = {key: value for key, value in now.items() if key in data}
        edited = _Editor(edited).change(now, kept) if kept.keys() != now.keys() else edited
        if equal(parse_yaml(edited), data):
            return edited
    except (_UnplacedError, yaml.YAMLError, AttributeError, LookupError):
        pass
    edited = "\n".join(_pair(key, value, 0) for key, value in data.items()) + "\n"
    try:
        if equal(parse_yaml(edited), data):
            return edited
        problem = "it is not read as it is written"
    except yaml.YAMLError as error:
        problem = str(getattr(error, "problem", None) or error)
    raise ValueError(f"no configuration can contain this value ({problem})")
