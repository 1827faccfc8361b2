"""The HTML of the drawing page: one document with its scripts inside."""

import base64
import functools
import hashlib
from importlib import resources


@functools.cache
def page() -> str:
    """Return the whole page."""
    body = _asset("evo_cpg.drawing.page", "page.html")
    style = _asset("evo_cpg.drawing.page", "page.css")
    scripts = "".join(f"<script>{script}</script>" for script in _scripts())
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="data:,"><title>evo-cpg model</title>'
        f"<style>{style}</style></head><body>{body}{scripts}</body></html>"
    )


@functools.cache
def policy() -> str:
    """Return the content security policy, which allows the page's own scripts and server alone."""
    digests = [
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in _scripts()
    ]
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; "
        "connect-src 'self'; img-src data: blob:; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )


@functools.cache
def _scripts() -> tuple[str, ...]:
    own = [_asset("evo_cpg.drawing.page", name) for name in ("view.js", "forms.js", "page.js")]
    return _asset("evo_cpg.view.page", "three.min.js"), *own


def _asset(package: str, name: str) -> str:
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")
