"""Data of the page of a recorded session, and what its server refuses; browsers use what it answers."""

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest
from aiohttp import ClientSession

from connectors.web import session_page as module
from connectors.web.session_page import SessionPage
from connectors.web.web_server import page_server
from flows.cli.show import load
from operators import Debounce
from operators.batch import Slips, Zeroed, ms, s
from operators.errors import InputError
from operators.ports import Run
from storage import Session
from tests.connectors.web.reading import scored, slip, touched
from tests.storage.made import new_samples, write_pad
from tests.waiting import PATIENCE

WINDOWS = (
    "begin=1&end=2&at=2",
    "begin=a&end=2&columns=9&at=2",
    "begin=nan&end=nan&columns=9&at=2",
    "begin=2&end=1&columns=9&at=2",
    "begin=0&end=1e300&columns=9&at=2",
    "begin=0&end=1&columns=0&at=2",
    "begin=0&end=1&columns=99999&at=2",
)
SPAN = '{"begin": 1, "end": 2, "finger": "0", "value": "slip", "author": "", "note": "", "created": ""}'
BODIES = (
    "",
    "[]",
    '{"spans": []}',
    '{"based_on": "0", "spans": []}',
    '{"based_on": 0, "spans": [{}]}',
    *(
        f'{{"based_on": 0, "spans": [{SPAN.replace(good, wrong)}]}}'
        for good, wrong in (
            ("2", "1"),
            ("2", "1e300"),
            ("1", f'"{"x" * 2**19}"'),
            ('"slip"', '"slid"'),
            ('"0"', '"x"'),
            ('"0"', '"9e9"'),
        )
    ),
    "[" * 100_000,
)
START = 90 * s
Keep: TypeAlias = Callable[..., Coroutine[Any, Any, SessionPage]]


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return write_pad(tmp_path)


@pytest.fixture
def keep(session: Session, run: Run) -> Keep:
    async def keep(*batches: Any) -> SessionPage:
        page = SessionPage(session, Debounce(), None, recorded=True)
        await page.open(run)
        for batch in batches:
            await page.write(batch)
        await page.close()
        return page

    return keep


def cut(recorded: SessionPage, begin: float, end: float) -> dict[str, Any]:
    return recorded.window(begin, end, 1000)


async def test_a_late_row_and_an_early_one_are_in_the_windows_of_their_times(keep: Keep) -> None:
    at = [10 * k for k in range(100)]
    at[30], at[70] = at[70], at[30]
    recorded = await keep(*[touched(START + k * ms, -k) for k in at])
    for begin in (200, 600):
        window = cut(recorded, begin, begin + 200)["touch 0"]
        assert window["t"] == [begin + 10.0 * k for k in range(21)]
        assert [row[0] for row in window["v"]] == [-time for time in window["t"]]


async def test_the_contents_end_after_the_newest_row_and_have_the_events_in_order_of_time(keep: Keep) -> None:
    batches: list[Zeroed | Slips] = [
        touched(START, -300),
        touched(START + 50 * ms, -300),
        *[slip(START + at * ms, state) for at, state in ((10, 1), (40, 0))],
        *[slip(START + at * ms, state, finger=2) for at, state in ((5, 1), (40, 0))],
    ]
    contents: dict[str, Any] = {**(await keep(*batches)).contents()}
    assert (contents["session"], contents["start"], contents["length"]) == ("one", 90_000, 60)
    assert contents["threshold"] == 0.5
    names = ("id", "t", "finger", "onset")
    assert [tuple(event[name] for name in names) for event in contents["events"]] == [
        (1, 5, "2", True),
        (2, 10, "0", True),
        (3, 40, "0", False),
        (4, 40, "2", False),
    ]


async def test_the_values_at_a_time_are_those_of_the_newest_row_of_the_last_second(keep: Keep) -> None:
    scores = [scored(START + k * 10 * ms, k / 10) for k in range(10)]
    recorded = await keep(touched(START - 2 * s, -7), *scores)
    for at, time in (45, [40]), (60, [60]), (-1, []):
        found: dict[str, Any] = recorded.window(at - 1000, at, None)
        assert (found["scores 0"]["t"], found["touch 0"]["t"]) == (time, [])


async def test_labels_are_runs_that_end_where_a_value_changes_or_a_pause_begins(keep: Keep) -> None:
    at = START + np.array([0, 10, 20, 30, 1000]) * ms
    labelled = replace(new_samples(at, finger=3), label=np.array([0, 0, 1, 1, 1], np.int8))
    contents: dict[str, Any] = {**(await keep(labelled)).contents()}
    assert contents["bands"] == {"label 3": [[0, 20, 0], [20, 30, 1], [1000, 1000, 1]]}


async def test_a_session_too_long_for_memory_is_rejected(keep: Keep, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ROWS_MAX", 2)
    with pytest.raises(InputError, match="one: is too long for a page, which shows at most 2 rows"):
        await keep(*[touched(START + k * ms, -1) for k in range(3)])


async def test_malformed_requests_are_refused_in_one_line(tmp_path: Path) -> None:
    session = write_pad(tmp_path)
    server, page = page_server("127.0.0.1", 0), await load(session, "none")
    await server.open(*page.routes)
    async with asyncio.timeout(PATIENCE), ClientSession(headers={"Origin": server.url}) as browser:
        for path in (*(f"/window?{each}" for each in WINDOWS), "/events?threshold=0", "/events"):
            async with browser.get(server.url + path) as response:
                assert (response.status, (await response.text()).count("\n")) == (400, 1), path
        for body in BODIES:
            async with browser.post(f"{server.url}/labels", data=body) as response:
                assert (response.status, (await response.text()).count("\n")) == (400, 1), body
    await server.close()
    assert session.hand_labels().version == 0
