"""Parts of every page: its files, its scripts, and its content security policy."""

import base64
import hashlib
import html
from collections.abc import Sequence
from importlib import resources
from typing import NamedTuple


class Page(NamedTuple):
    """A page that a server sends.

    Attributes:
        text: the whole page, as HTML.
        policy: its content security policy.
    """

    text: str
    policy: str


def served_page(title: str, style: str, body: str, scripts: Sequence[str]) -> Page:
    """Return a page that may run its own scripts and call its own server, and nothing else.

    Args:
        title: title of the page, as text.
        style: style sheets.
        body: HTML of the body, which is not escaped.
        scripts: scripts in their order.
    """
    inline = "".join(f"<script>{script}</script>" for script in scripts)
    text = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{html.escape(title)}</title>'
        f"<style>{style}</style></head><body>{body}{inline}</body></html>"
    )
    return Page(text, f"{policy(scripts)}; connect-src 'self'; frame-ancestors 'none'")


def policy(scripts: Sequence[str]) -> str:
    """Return a content security policy that allows some scripts, and no request.

    Args:
        scripts: texts of the scripts, which the policy names by their digests.
    """
    digests = [
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts
    ]
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: "
        "blob:; base-uri 'none'; form-action 'none'"
    )


def asset(name: str, package: str = "evo_cpg.view.page") -> str:
    """Return the text of a file of a page.

    Args:
        name: name of the file.
        package: package that holds it.
    """
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")
