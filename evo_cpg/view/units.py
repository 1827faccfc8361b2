"""Units of a task's terms and of measures of gait, for pictures."""

from evo_cpg.view.legible import legible

# Units by name. All other terms have no unit.
UNITS = {
    "amplitude": "rad", "bounce": "m", "distance": "m", "energy": "J", "forward": "m",
    "frequency": "Hz", "power": "W", "speed": "m/s", "stride_length": "m",
    "turning": "rad/s",
}  # fmt: skip


def in_words(name: str) -> str:
    """Return the name of a term, such as ``duty factor``."""
    return legible(name.replace("_", " "))


def terms_text(terms: dict[str, float]) -> str:
    """Return terms with their values and units, such as ``speed 0.31 m/s, duty factor 0.62``."""
    return ", ".join(
        f"{in_words(name)} {value:.3g} {UNITS.get(name, '')}".rstrip()
        for name, value in terms.items()
    )
