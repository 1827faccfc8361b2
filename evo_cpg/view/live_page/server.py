"""The live page of a run, which is empty until its script asks the server, and the server."""

from collections.abc import Mapping
from typing import Any

from evo_cpg.view.live_page.following import Following
from evo_cpg.view.run_page.document import player
from evo_cpg.view.run_page.html import asset, join, tag, whole_page
from evo_cpg.view.run_page.server import PageServer


def live_server(run: Following, name: str, port: int = 0) -> PageServer:
    """Return the server of the page of one run, on a free port if it is 0."""
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
    own = "evo_cpg.view.live_page"
    style = asset("page.css") + asset("live.css", own)
    scripts = [asset(script) for script in ("three.min.js", "animal.js", "viewer.js")]
    scripts += [asset(script, own) for script in ("wall.js", "live.js")]

    page = whole_page(name, style, body, scripts, is_served=True)

    def get(path: str, query: Mapping[str, str]) -> Any:
        if path != "/state":
            return None
        # Numbers of what the page shows already.
        given = (query.get(each, "") for each in ("chart", "motion", "wall", "tiles"))
        return run.answer(*(int(each) if each.isdecimal() else 0 for each in given))

    return PageServer(page, get, port=port)
