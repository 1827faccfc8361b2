"""Write the tables of what an import of MJCF and URDF maps, refuses and leaves out."""

from evo_cpg.io.models import mjcf_fields

_KINDS = {"dof": "joint", "wrap": "tendon"}


def tables() -> str:
    """Return the tables, made from those of the import."""
    read = mjcf_fields.READ | mjcf_fields.READ_LIMITS | mjcf_fields.COMPUTED
    mapped: dict[tuple[str, str], list[str]] = {}
    for source in read.values():
        kind = _KINDS.get(source.kind, source.kind)
        mapped.setdefault((kind, source.key), []).append(source.word)
    rows = [
        f"| `{kind}` | {', '.join(dict.fromkeys(', '.join(words).split(', ')))} | {key} |"
        for (kind, key), words in mapped.items()
    ]
    flags = [f"| `{flag}` | {effect} |" for flag, effect in mjcf_fields.FLAGS.items()]
    return "\n".join(
        [
            "**Mapped**",
            "",
            "| Element | Attribute | Key of the configuration |",
            "|---|---|---|",
            *sorted(rows),
            "",
            "**Flags** of `option` that switch a part off",
            "",
            "| Flag | Effect |",
            "|---|---|",
            *flags,
            "",
            "**Refused**, because it would change the motion. `--drop` accepts the loss.",
            "",
            "| Element | Attribute |",
            "|---|---|",
            *_by_kind(mjcf_fields.REFUSED),
            *(f"| `{kind}` | all |" for kind in mjcf_fields.REFUSED_COUNTS.values()),
            "",
            "**Left out, by name**: softness and rules of contacts and limits, and what has no "
            "part in the motion.",
            "",
            "| Element | Attribute |",
            "|---|---|",
            *_by_kind(mjcf_fields.LEFT_OUT),
            f"| `option` | {', '.join(mjcf_fields.OPTIONS_LEFT_OUT)} |",
            *(f"| `{kind}` | all |" for kind in mjcf_fields.COUNTS.values()),
        ]
    )


def _by_kind(table: dict[str, mjcf_fields.Neutral]) -> list[str]:
    """Return a row for each kind of elements, with its attributes."""
    words: dict[str, list[str]] = {}
    for field in table.values():
        words.setdefault(_KINDS.get(field.kind, field.kind), []).append(field.word)
    return [f"| `{kind}` | {', '.join(names)} |" for kind, names in words.items()]
