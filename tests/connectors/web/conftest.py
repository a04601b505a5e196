"""A real browser for the tests of pages: headless Chromium."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, ViewportSize, expect, sync_playwright

from tests.connectors.web.browsing import FLAGS, LATE, Watched


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture
def watched(browser: Browser) -> Iterator[Watched]:
    expect.set_options(timeout=LATE)
    context = browser.new_context(viewport=ViewportSize(width=1280, height=860))
    yield Watched(context.new_page())
    context.close()
