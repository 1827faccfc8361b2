"""What a page tells of how a configuration departs from the shipped one and from its paper."""

from typing import Any, NamedTuple


class Difference(NamedTuple):
    """A value that is not that of the shipped configuration; None where there is none."""

    key: str
    shipped: Any
    own: Any


class Note(NamedTuple):
    """What a shipped file says of one of its values.

    Attributes:
        key: of the value, within its file.
        value: as it is written.
        text: the comment.
        ours: whether it is ours, and not the paper's.
    """

    key: str
    value: str
    text: str
    ours: bool


class Departures(NamedTuple):
    """Of a configuration that goes by the name of a shipped one.

    Attributes:
        about: the comment at the top of the shipped file.
        differences: what differs from it.
        notes: what the shipped files say of their values.
    """

    about: str
    differences: tuple[Difference, ...]
    notes: tuple[Note, ...]
