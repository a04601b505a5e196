"""Pictures of the pages for the documentation, run by `make figures`.

The live page shows the demo on the simulated rig in real time; `show` a session of the plan tiny, zoomed,
with spans labelled by hand.
"""

import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal, TypeAlias

from PIL import Image
from playwright.sync_api import Browser, Page, ViewportSize, expect

from flows.cli.show import load
from flows.lab.simulation import simulate
from storage import Session
from tests.command import SLIPFLOW
from tests.connectors.web.browsing import LATE, MOVE, ServedRecording, chromium, drag

WARM: Final = 8.0  # s until the physics is compiled and the baseline is learned
SERVED: Final = "live page: "  # begins the line that names the address of the page
SESSION: Final = "plane-050-01"
SELECTED: Final = 8300  # ms, in a slip of this session
Scheme: TypeAlias = Literal["light", "dark"]
LIVE: Final[tuple[tuple[str, int, int, Scheme, bool], ...]] = (  # width and height, px; True: while it slips
    ("light", 1280, 860, "light", True),
    ("dark", 1280, 860, "dark", False),
    ("phone", 390, 844, "light", True),
)
LABELS: Final = ((0.02, 0.07, "t"), (0.27, 0.36, "s"), (0.36, 0.42, "u"), (0.62, 0.74, "s"))  # shares, key


@contextmanager
def served_demo() -> Generator[str]:
    """The demo in a process of its own, from when its page is served: its address."""
    with TemporaryDirectory() as folder:
        words = ["demo", "--for", "10min", "--no-browser", "--out", f"{folder}/recordings"]
        demo = subprocess.Popen(
            [*SLIPFLOW, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        try:
            assert demo.stderr
            served = next((line for line in demo.stderr if SERVED in line), None)
            if served is None:
                raise SystemExit("the demo ended before its page was served")
            yield served.partition(SERVED)[2].split()[0]
        finally:
            demo.terminate()
            demo.communicate()


def caught(tab: Page, *, slips: bool) -> bytes:
    """Return a picture in a state; meanwhile the page requests no frame."""
    state = f"[data-link=live] #state[data-slip={str(slips).lower()}]"
    tab.evaluate("() => { window.send = WebSocket.prototype.send; }")
    while True:
        tab.wait_for_selector(f"#state[data-slip={str(not slips).lower()}]")  # just when it changes
        tab.wait_for_selector(state)
        tab.wait_for_timeout(100)  # the numbers follow
        tab.evaluate("() => { WebSocket.prototype.send = () => {}; }")
        tab.wait_for_timeout(200)
        if tab.locator(state).count():
            return tab.screenshot(full_page=True)
        tab.evaluate("() => { WebSocket.prototype.send = window.send; }")  # the page reconnects


def live_pictures(browser: Browser, url: str, folder: Path) -> None:
    """Write the pictures of the live page."""
    for name, width, height, scheme, slips in LIVE:
        context = browser.new_context(viewport=ViewportSize(width=width, height=height), color_scheme=scheme)
        tab = context.new_page()
        tab.goto(url)
        tab.wait_for_timeout(1000 * (WARM if name == "light" else 2))
        save(caught(tab, slips=slips), folder / f"page-{name}.png")
        context.close()


def show_picture(browser: Browser, dataset: Path, folder: Path) -> None:
    """Write the picture of a recorded session."""
    with ServedRecording(load(Session.open(dataset / "sessions" / SESSION))) as served:
        tab = browser.new_page(viewport=ViewportSize(width=1280, height=1180), color_scheme="light")
        tab.set_default_timeout(LATE)
        tab.goto(served.url)
        expect(tab.locator("#readout")).to_contain_text("UTC")
        drag(tab, tab.locator("#counts"), 0.25, 0.85)
        expect(tab.locator("#unzoom")).to_be_visible()
        tab.get_by_label("Your name").fill("Ada")
        for begin, end, key in LABELS:
            drag(tab, tab.locator("#bands"), begin, end)
            tab.keyboard.press(key)
        tab.locator("#instant").evaluate(MOVE, SELECTED)
        tab.wait_for_timeout(500)
        save(tab.screenshot(full_page=True), folder / "show.png")


def save(png: bytes, path: Path) -> None:
    """Write a picture with 256 colours."""
    with Image.open(BytesIO(png)) as image:
        few = image.convert("RGB").quantize(256, kmeans=3, dither=Image.Dither.NONE)
        few.save(path, optimize=True)


def main(folder: Path) -> None:
    """Write all pictures into a folder."""
    with TemporaryDirectory() as scratch:
        dataset = simulate(Path(scratch) / "tiny", "tiny", seed=0)
        with chromium() as browser:  # no other event loop can run in this thread
            show_picture(browser, dataset, folder)
            with served_demo() as url:
                live_pictures(browser, url, folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
