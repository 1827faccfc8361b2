"""Commands of the page: the edits by name, with checked arguments."""

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from evo_cpg.creature.creature import CreatureError
from evo_cpg.io.errors import KeyProblem
from evo_cpg.view.drawing_page import blocks, joints, lofting, parts, placing, sensors, world
from evo_cpg.view.drawing_page.arguments import checked_arguments
from evo_cpg.view.drawing_page.document import Data, DrawingError, Edit

COMMANDS: Mapping[str, Callable[..., Any]] = {
    each.__name__: each
    for each in (
        parts.add_part,
        parts.add_shape,
        parts.remove_shape,
        parts.remove_part,
        parts.rename_part,
        parts.set_shape,
        joints.set_joint,
        joints.set_axes,
        parts.resize,
        parts.stretch,
        lofting.add_section,
        lofting.remove_section,
        lofting.move_section,
        lofting.scale_section,
        placing.shift,
        placing.turn,
        blocks.mirror,
        blocks.repeat,
        blocks.radial,
        blocks.separate,
        sensors.add_eye,
        sensors.add_depth_gauge,
        sensors.remove_sensor,
        sensors.set_pressure,
        world.set_water,
        world.set_ground,
        world.set_value,
        world.unset_value,
    )
}


def edit(command: str, source: Path, given: Mapping[str, Any]) -> Edit:
    """Return an edit of a document.

    Args:
        command: name of the command, the function's name.
        source: file of the document.
        given: arguments of the command.

    Raises:
        DrawingError: there is no such command, or an argument is missing, unknown or of a wrong
            type. The edit raises it if it is not possible.
    """
    function = COMMANDS.get(command)
    if function is None:
        raise DrawingError(f"there is no command {command!r}. Commands: {', '.join(COMMANDS)}")
    known = checked_arguments(command, function, given)
    if "source" in inspect.signature(function).parameters:
        known["source"] = source

    def apply(data: Data) -> None:
        try:
            function(data, **known)
        except DrawingError:
            raise
        except KeyProblem as error:
            # The creature is wrong at another place, which `problems` reports, too.
            raise DrawingError(
                f"first mend {'.'.join(map(str, error.key))}: {error.problem}"
            ) from None
        except CreatureError as error:
            raise DrawingError(f"first mend the creature: {error}") from None
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise DrawingError(f"{command} is not possible here ({error})") from None

    return apply
