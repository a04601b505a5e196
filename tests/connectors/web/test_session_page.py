"""What the server refuses; test_browser_recorded.py uses what it answers."""

import asyncio
from pathlib import Path

from aiohttp import ClientSession

from connectors.web.web_server import page_server
from flows.cli.show import load
from tests.storage.made import write_pad
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
            ('"slip"', '"slid"'),
            ('"0"', '"x"'),
            ('"0"', '"9e9"'),
        )
    ),
    "[" * 100_000,
)


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
