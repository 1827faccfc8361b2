"""Which program this is."""

from importlib import metadata

from evo_cpg.api.commit import commit


def version() -> str:
    """Name and version and, in a checkout, the commit."""
    words = f"evo-cpg {metadata.version('evo-cpg')}"
    made_by = commit()
    return f"{words} ({made_by})" if made_by else words
