"""A real browser for the tests of pages: headless Chromium."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, ViewportSize, expect

from tests.connectors.web.browsing import LATE, Watched, chromium


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as started:  # occupies the event loop of this thread: not for other modules
        yield started


@pytest.fixture
def watched(browser: Browser) -> Iterator[Watched]:
    expect.set_options(timeout=LATE)
    context = browser.new_context(viewport=ViewportSize(width=1280, height=860))
    watched = Watched(context.new_page())
    yield watched
    assert watched.complaints == []
    context.close()
