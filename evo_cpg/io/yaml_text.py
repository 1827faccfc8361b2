"""Reading and writing of configurations as YAML, without loss."""

import re
from typing import Any

import yaml

# The loader of libyaml is ten times faster, if PyYAML was built with it.
_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_INT, _FLOAT = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
_TIMESTAMP = "tag:yaml.org,2002:timestamp"
_TEXT = "tag:yaml.org,2002:str"
_DIGITS = list("-+.0123456789")
_LINE_ENDS = "\x85\u2028\u2029"
# Forms of numbers here. PyYAML (YAML 1.1) would read 1e-3, 1.0e5 and -.5 as text, 0200 as 128 and
# 1:40 as 100.
_NUMBERS = {
    _INT: re.compile(r"[-+]?(0|[1-9][0-9_]*|0x[0-9a-fA-F_]+|0b[01_]+)$"),
    _FLOAT: re.compile(
        r"[-+]?((\d[\d_]*)?\.\d[\d_]*|\d[\d_]*\.?)([eE][-+]?\d+)$"
        r"|[-+]?(\d[\d_]*\.[\d_]*|\.\d[\d_]*)$"
        r"|[-+]?\.(inf|Inf|INF)$|\.(nan|NaN|NAN)$"
    ),
}

# Largest depth of nesting. Sections of configurations are nested at most ten deep.
_DEEPEST = 50

# Largest number of values, with aliases expanded: seven times that of the largest relief.
_MOST_VALUES = 500_000


class _Loader(_SafeLoader):
    """Loader of safe YAML without some of its traps.

    The traps are keys given twice, numbers that PyYAML reads as text or as other numbers, and
    dates, which no configuration contains.
    """

    def construct_document(self, node: yaml.Node) -> Any:
        """Refuse a key given twice, because only its last value would count.

        The check runs before ``<<`` copies the keys of one mapping into another.
        """
        left, seen = [node], set()
        while left:
            one = left.pop()
            if id(one) in seen or not isinstance(one, yaml.CollectionNode):
                continue
            seen.add(id(one))
            if isinstance(one, yaml.MappingNode):
                names = set()
                for key, value in one.value:
                    if isinstance(key, yaml.ScalarNode) and key.value in names:
                        raise yaml.constructor.ConstructorError(
                            None, None, f"the key {key.value!r} is given twice", key.start_mark
                        )
                    names.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
                    left += [key, value]
            else:
                left += one.value
        return super().construct_document(node)


class _Dumper(yaml.SafeDumper):
    """Dumper that quotes text which YAML 1.1 or this loader would read as a number."""


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in found if tag not in (_INT, _FLOAT, _TIMESTAMP)]
    for first, found in _SafeLoader.yaml_implicit_resolvers.items()
}
for _tag, _pattern in _NUMBERS.items():
    _Loader.add_implicit_resolver(_tag, _pattern, _DIGITS)
    _Dumper.add_implicit_resolver(_tag, _pattern, _DIGITS)


# Text is in double quotation marks if YAML would read one of its characters as a line end.
_Dumper.add_representer(
    str,
    lambda dumper, text: dumper.represent_scalar(
        _TEXT, text, style='"' if any(end in text for end in _LINE_ENDS) else None
    ),
)


def parse_yaml(text: str) -> Any:
    """Return the contents of a YAML text.

    Raises:
        yaml.YAMLError: the text is not YAML, or exceeds the size limits.
    """
    _require_shallow(text)
    try:
        return yaml.load(text, _Loader)
    except (ArithmeticError, AttributeError, LookupError, ValueError) as error:
        # A value is too long, or has the tag of another type, such as ``!!int x``.
        raise yaml.MarkedYAMLError(problem=f"a value cannot be read ({error})") from None


def compose_yaml(text: str) -> yaml.Node | None:
    """Return the nodes of a YAML text, which contain their line numbers.

    Raises:
        yaml.YAMLError: the text is not YAML, or exceeds the size limits.
    """
    _require_shallow(text)
    return yaml.compose(text, _Loader)


def to_yaml(data: Any, flow: bool | None = False) -> str:
    """Return data as a YAML text.

    Args:
        data: text, numbers, booleans, None, and lists and mappings of them.
        flow: whether to write brackets, on one line, or None for brackets at the innermost level.
    """
    return yaml.dump(
        data,
        Dumper=_Dumper,
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=flow,
        width=10**9 if flow else None,
    )


def _require_shallow(text: str) -> None:
    """Check that YAML does not exceed the limits for depth and number of values.

    An alias counts as all its values, because a few lines of aliases could fill the memory.

    Raises:
        yaml.YAMLError: a limit is exceeded, an alias contains itself, or the text is not YAML.
    """
    # Anchor of every open collection, and number of values in it so far.
    opened: list[tuple[str | None, int]] = [(None, 0)]
    sizes: dict[str, int | None] = {}
    for event in yaml.parse(text, _Loader):
        added, problem = 0, None
        anchor = getattr(event, "anchor", None)
        if isinstance(event, yaml.CollectionStartEvent):
            opened.append((anchor, 1))
            if anchor:
                sizes[anchor] = None
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, added = opened.pop()
            if anchor:
                sizes[anchor] = added
        elif isinstance(event, yaml.AliasEvent):
            size = sizes.get(event.anchor, 0)
            if size is None:
                problem = f"the alias *{event.anchor} is inside its own anchor"
            added = size or 0
        elif isinstance(event, yaml.ScalarEvent):
            added = 1
            if anchor:
                sizes[anchor] = 1
        opened[-1] = opened[-1][0], opened[-1][1] + added
        if len(opened) > _DEEPEST:
            problem = f"nested more than {_DEEPEST} levels deep"
        if opened[-1][1] > _MOST_VALUES:
            problem = f"more than {_MOST_VALUES} values"
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)


# Largest length of the line that a message about invalid YAML quotes.
_QUOTED = 60

# A colour without quotes, which YAML reads as a comment.
_COLOUR = re.compile(r"^[^#\n]*\bcolor:[ \t]+(#[0-9a-fA-F]{6})\b", re.MULTILINE)


def syntax_problem(text: str, error: yaml.YAMLError) -> tuple[str, str]:
    """Return the place of an error in YAML, and the parser's message on one line.

    Returns:
        ``line 3, column 7``, empty if it is unknown, and the problem with the invalid line.
    """
    mark = getattr(error, "problem_mark", None)
    problem = getattr(error, "problem", None) or getattr(error, "reason", "cannot be parsed")
    if mark:
        row, column = mark.line, mark.column
    elif isinstance(error, yaml.reader.ReaderError):
        # Its position counts bytes, so look for the forbidden character.
        before = text[: max(text.find(chr(error.character)), 0)]
        row, column = before.count("\n"), len(before.rpartition("\n")[2])
    else:
        return "", problem
    line = (text.splitlines()[row : row + 1] or [""])[0]
    if re.match(r"[ -]*\t", line):
        problem = f"{problem}. YAML allows only spaces at the beginning of a line"
    quoted = f": {line.strip()[:_QUOTED]!r}" if line.strip() else ""
    return f"line {row + 1}, column {column + 1}", f"{problem}{quoted}"


def lost_colour(text: str) -> str | None:
    """Return the problem of a colour without quotes, read as a comment, or None without one."""
    found = _COLOUR.search(text)
    if found is None:
        return None
    line = text.count("\n", 0, found.start(1)) + 1
    return f"line {line}: color: # begins a comment. Write the color in quotes: '{found[1]}'"
