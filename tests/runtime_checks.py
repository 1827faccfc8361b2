"""Type checker that `conftest` applies to every function and class of the package."""

import typing

import beartype
from typing_extensions import is_protocol

# An int is allowed for a float, as in PEP 484.
_check = beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))


def typechecker(checked):
    """Return a function that checks its arguments, or a class whose methods do."""
    for hint in getattr(checked, "__annotations__", {}).values():
        # The package never asks whether an object has a protocol, but the check does.
        if is_protocol(hint):
            typing.runtime_checkable(hint)
    return _check(checked)
