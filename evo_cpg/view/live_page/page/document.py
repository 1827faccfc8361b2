"""The HTML of the live page of a run."""

from evo_cpg.view.run_page.document import player
from evo_cpg.view.run_page.html import Page, asset, join, served_page, tag


def page(name: str) -> Page:
    """Return the page of a run, which is empty until its script asks the server.

    Args:
        name: name of the run.
    """
    waiting = tag("p", "The newest champion appears here as soon as it is replayed.", id="before")
    body = join(
        tag("h1", name),
        tag("p", class_="lead", id="status", role="status"),
        tag("div",
            tag("div", player(waiting), tag("p", class_="note", id="champion")),
            tag("div", tag("ul", class_="cards", id="numbers"), tag("div", id="curves")),
            id="now"),
        tag("section",
            tag("h2", "The population"),
            tag("p",
                tag("span", id="which"), " ",
                tag("button", "Pause", type="button", id="pause", aria_pressed="false")),
            tag("div", tag("canvas", aria_hidden="true"), tag("ol"), id="wall"),
            id="population", hidden=True),
        tag("footer", "This page calls the program that printed its address, and nothing else. The "
            "animals are drawn by three.js (MIT licence)."),
    )  # fmt: skip
    own = "evo_cpg.view.live_page.page"
    style = asset("page.css") + asset("live.css", own)
    scripts = [asset(script) for script in ("three.min.js", "animal.js", "viewer.js")]
    scripts += [asset(script, own) for script in ("wall.js", "live.js")]
    return served_page(name, style, body, scripts)
