"""Table of a gait's numbers on the terminal, beside those of animals."""

import textwrap
from collections.abc import Sequence

from evo_cpg.analysis.gait_quantities import Quantity
from evo_cpg.cli.tables import show_table

# Width of the lines below the table, characters.
_WIDTH = 80


def show_numbers(quantities: Sequence[Quantity]) -> None:
    """Print the numbers that exist, and the reasons why others are missing.

    Args:
        quantities: measured numbers.
    """
    rows = [
        [
            each.name,
            _digits(each.value),
            each.unit,
            "; ".join(f"{animals.range} {animals.animal}" for animals in each.animals),
        ]
        for each in quantities
        if each.exists
    ]
    show_table(["number", "value", "unit", "animals"], rows, left=4)
    _show_missing(quantities)


def _digits(value: float) -> str:
    """Return a number with three digits, and without an exponent from 1000 to 1e9."""
    words = f"{value:.3g}"
    return f"{float(words):.0f}" if 1e3 <= abs(value) < 1e9 else words


def _show_missing(quantities: Sequence[Quantity]) -> None:
    missing: dict[str, list[str]] = {}
    for each in quantities:
        if not each.exists and each.missing:
            missing.setdefault(each.missing, []).append(each.name)
    for reason, names in missing.items():
        print(textwrap.fill(f"no {', '.join(names)}: {reason}", _WIDTH))
