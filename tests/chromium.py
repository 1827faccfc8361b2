"""A headless Chromium that tests control through a pipe with its DevTools protocol.

It needs no library and no port. `--remote-debugging-pipe` reads messages on file descriptor 3 and
answers on 4. A zero byte ends each message (https://chromedevtools.github.io/devtools-protocol/).
"""

import base64
import contextlib
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")

# WebGL without a graphics card.
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-gpu-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--hide-scrollbars",
    "--mute-audio",
)
# Longest wait, s: the whole suite may run on a busy machine meanwhile.
_PATIENCE = 300.0

# Text and pictures that end outside the window, except in a small box that scrolls, such as code.
# The drawers of the docs' theme wait outside the window.
_CUT = """(() => {
  const found = [];
  const cut = "img, iframe, p, li, td, th, pre, math, figure, button, h1, h2, h3, a, select, svg";
  const whole = "body, .page, .main, .content, article, section, .drawing, .wide";
  for (const element of document.body.querySelectorAll(cut)) {
    if (element.closest(".sidebar-drawer, .toc-drawer, .skip-to-content, .visually-hidden"))
      continue;
    const box = element.getBoundingClientRect();
    if (!box.width || !box.height || box.right <= innerWidth + 1) continue;
    let above = element.parentElement;
    while (above && (
      above.matches(whole) || !["auto", "scroll"].includes(getComputedStyle(above).overflowX)
    )) above = above.parentElement;
    if (above) continue;
    found.push(element.tagName + " " + element.textContent.trim().slice(0, 60));
  }
  if (document.documentElement.scrollWidth > innerWidth) found.push("the page scrolls sideways");
  return found;
})()"""


def found() -> str | None:
    """Return the path of the program, or None if there is none."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Page:
    """A tab."""

    def __init__(self, send: int, receive: int):
        self._send, self._receive, self._number = send, receive, 0
        self._left = b""
        self._session: str | None = None
        self.events: list[dict[str, Any]] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        made = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = made["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **given: Any) -> dict[str, Any]:
        """Send a command and wait for its answer."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": given}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._send, json.dumps(message).encode() + b"\0")
        until = time.monotonic() + _PATIENCE
        while True:
            answer = self._next(until)
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def open(self, path: Path, size: tuple[int, int] = (1280, 900), dark: bool = False) -> None:
        """Open a file without a network, and wait until it is loaded."""
        self.call("Network.emulateNetworkConditions", offline=True, latency=0,
                  downloadThroughput=-1, uploadThroughput=-1)  # fmt: skip
        self.resize(size)
        features = [
            {"name": "prefers-color-scheme", "value": "dark" if dark else "light"},
            {"name": "prefers-reduced-motion", "value": "reduce"},
        ]
        self.call("Emulation.setEmulatedMedia", features=features)
        self.call("Page.navigate", url=path.resolve().as_uri())
        self.wait("document.readyState === 'complete'")

    def visit(self, address: str, size: tuple[int, int] = (1280, 900), dark: bool = False) -> None:
        """Open an address of this machine, and wait until it is loaded."""
        self.resize(size)
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=features)
        self.call("Page.navigate", url=address)
        self.wait("document.readyState === 'complete'")

    def resize(self, size: tuple[int, int]) -> None:
        """Set the size of the window, pixels."""
        self.call("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1],
                  deviceScaleFactor=1, mobile=False)  # fmt: skip

    def run(self, script: str) -> Any:
        """Return the value of a JavaScript expression. Wait for a promise."""
        answer = self.call(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{script}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait(self, condition: str, patience: float = _PATIENCE) -> None:
        """Wait until a JavaScript expression is true, at most some time, s."""
        until = time.monotonic() + patience
        while not self.run(condition):
            if time.monotonic() > until:
                raise TimeoutError(condition)
            time.sleep(0.05)

    def picture(self, selector: str | None = None) -> bytes:
        """Return a PNG of an element, or of the whole page."""
        element = f"document.querySelector({(selector or 'html')!r})"
        box = self.run(
            f"(() => {{ const b = {element}.getBoundingClientRect();"
            " return {x: b.x + scrollX, y: b.y + scrollY, width: b.width, height: b.height}; })()"
        )
        # The latest changes are on the screen after two frames.
        self.run("new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))")
        answer = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=True,
                         clip=box | {"scale": 1})  # fmt: skip
        return base64.b64decode(answer["data"])

    def click(self, selector: str) -> None:
        """Click into the middle of an element with the mouse."""
        self.run(f"document.querySelector({selector!r}).scrollIntoView({{block: 'center'}})")
        box = self.run(
            f"(() => {{ const b = document.querySelector({selector!r}).getBoundingClientRect();"
            " return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        self.mouse("mousePressed", box)
        self.mouse("mouseReleased", box)

    def mouse(self, what: str, place: list[float]) -> None:
        """Press, move or release the left button."""
        self.call("Input.dispatchMouseEvent", type=what, x=place[0], y=place[1], button="left",
                  buttons=0 if what == "mouseReleased" else 1, clickCount=1)  # fmt: skip

    def give_file(self, selector: str, path: Path) -> None:
        """Choose a file in a field of files."""
        field = self.call("Runtime.evaluate", expression=f"document.querySelector({selector!r})")
        self.call("DOM.setFileInputFiles", files=[str(path)], objectId=field["result"]["objectId"])

    def paper(self) -> bytes:
        """Return a PDF of the page."""
        answer = self.call("Page.printToPDF", printBackground=True, preferCSSPageSize=True,
                         paperWidth=8.27, paperHeight=11.69)  # fmt: skip
        return base64.b64decode(answer["data"])

    def cut(self) -> list[str]:
        """Return what a reader does not see whole in the window without scrolling sideways."""
        return self.run(_CUT)

    @property
    def requests(self) -> list[str]:
        """Requested addresses."""
        return [
            event["params"]["request"]["url"]
            for event in self.events
            if event.get("method") == "Network.requestWillBeSent"
        ]

    @property
    def complaints(self) -> list[str]:
        """Errors and warnings of the console, and thrown exceptions."""
        found = []
        for event in self.events:
            answer = event.get("params", {})
            if event.get("method") == "Runtime.exceptionThrown":
                found.append(str(answer["exceptionDetails"]))
            if event.get("method") == "Runtime.consoleAPICalled" and answer["type"] in (
                "error",
                "warning",
                "assert",
            ):
                found.append(str(answer["args"]))
            if event.get("method") == "Log.entryAdded" and answer["entry"]["level"] == "error":
                found.append(answer["entry"]["text"])
        return found

    def _next(self, until: float) -> dict[str, Any]:
        while b"\0" not in self._left:
            ready, _, _ = select.select([self._receive], [], [], max(0.0, until - time.monotonic()))
            part = os.read(self._receive, 1 << 16) if ready else b""
            if not part:
                raise TimeoutError("Chromium does not answer")
            self._left += part
        message, _, self._left = self._left.partition(b"\0")
        return json.loads(message)


@contextlib.contextmanager
def browser(folder: Path) -> Iterator[Page]:
    """Start a browser with a separate profile. There must be one (`found`).

    Args:
        folder: folder for the profile.
    """
    program = found()
    assert program is not None
    their_input, send = os.pipe()
    receive, their_output = os.pipe()
    flags = (*_FLAGS, "--remote-debugging-pipe", f"--user-data-dir={folder}")
    # The shell connects the pipes to the file descriptors, because JAX warns after a fork.
    command = f'exec "$@" 3<&{their_input} 4>&{their_output}'
    process = subprocess.Popen(
        ["bash", "-c", command, "bash", program, *flags, "about:blank"],
        pass_fds=(their_input, their_output),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(their_input)
    os.close(their_output)
    try:
        yield Page(send, receive)
    finally:
        process.kill()
        process.wait()
        os.close(send)
        os.close(receive)
