"""The HTML of the drawing page: one document with its scripts inside."""

import functools

from evo_cpg.view.run_page.html import Page, asset, served_page


@functools.cache
def page() -> Page:
    """Return the whole page."""
    body, style, *own = (
        asset(name, "evo_cpg.view.drawing_page.page")
        for name in ("page.html", "page.css", "view.js", "forms.js", "page.js")
    )
    shared = [asset(name) for name in ("three.min.js", "animal.js")]
    return served_page("evo-cpg model", style, body, [*shared, *own])
