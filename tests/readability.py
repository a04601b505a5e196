"""Readability of pages in Chromium: on a desk and on a phone, light and dark."""

from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final, Literal, TypeAlias

from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright

from flows.report.report_page import Report
from tests.connectors.web.browsing import FLAGS

ReportFaults: TypeAlias = Callable[[Report, Path], list[str]]
WIDTHS: Final = (1280, 390)  # px
SCHEMES: Final[tuple[Literal["light", "dark"], ...]] = ("light", "dark")
_CHECK: Final = Path(__file__).with_suffix(".js").read_text(encoding="utf-8")


@contextmanager
def chromium() -> Generator[Browser]:
    """Start headless Chromium."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=FLAGS)
        yield browser
        browser.close()


def faults(browser: Browser, url: str, ready: Callable[[Page], object] = Page.title) -> list[str]:
    """Return what makes a page and its frames hard to read, in all widths and schemes.

    `ready` waits for the content.
    """
    found = list[str]()
    for width in WIDTHS:
        context = browser.new_context(viewport=ViewportSize(width=width, height=860))
        tab = context.new_page()
        tab.goto(url)
        for scheme in SCHEMES:
            tab.emulate_media(color_scheme=scheme)
            ready(tab)
            seen: list[str] = [
                each for frame in tab.frames for each in frame.evaluate(_CHECK, {"phone": width < WIDTHS[0]})
            ]
            found += [f"{width} px, {scheme}: {each}" for each in dict.fromkeys(seen)]
        context.close()
    return found


@contextmanager
def report_reader() -> Generator[ReportFaults]:
    """Start Chromium for reports: give a function that returns what makes the page of one hard to read."""
    with (
        ThreadPoolExecutor(1) as pool,
        ExitStack() as stack,
    ):  # Playwright occupies the event loop of a thread
        browser = pool.submit(stack.enter_context, chromium()).result()

        def report_faults(report: Report, folder: Path) -> list[str]:
            page = folder / "page.html"
            page.write_text(report.html(), encoding="utf-8")
            return pool.submit(faults, browser, page.as_uri()).result()

        try:
            yield report_faults
        finally:
            pool.submit(stack.close).result()
