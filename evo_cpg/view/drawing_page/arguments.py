"""Arguments that a page gives to a function, checked against the types in its signature."""

import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any, get_type_hints

from pydantic import create_model

from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.schema.section import Section
from evo_cpg.io.wording import checked
from evo_cpg.view.drawing_page.document import DrawingError

# Parameters that the program gives.
_OWN = ("data", "source")


def checked_arguments(
    name: str, function: Callable[..., Any], given: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the arguments of a function, converted to its types, with defaults.

    Args:
        name: name of the function on the page, for messages.
        function: the function.
        given: arguments by name, from JSON.

    Raises:
        DrawingError: an argument is missing, unknown or of a wrong type.
    """
    try:
        return dict(checked(_model(function), dict(given)))
    except KeyProblem as error:
        raise DrawingError(f"{name}: {error}") from None


@functools.cache
def _model(function: Callable[..., Any]) -> type[Section]:
    types = get_type_hints(function, include_extras=True)
    fields: dict[str, Any] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if name not in _OWN and name != "self":
            required = parameter.default is parameter.empty
            fields[name] = (types[name], ... if required else parameter.default)
    return create_model(function.__name__, __base__=Section, **fields)
