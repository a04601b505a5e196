"""The live page as a browser reads it; the content of frames is tested in test_page_frames.py."""

import asyncio
import re
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, TypeAlias

import numpy as np
import pytest
from aiohttp import ClientSession

from connectors import Page
from operators.batch import Touch, Zeroed, ms, s
from operators.ports import Run
from tests.connectors.web.reading import listening, slip
from tests.waiting import PATIENCE

Frames: TypeAlias = AsyncIterator[dict[str, Any]]

NOW = 100 * s


@asynccontextmanager
async def opened(run: Run) -> AsyncGenerator[tuple[Page, Frames]]:
    """Open a page of raw and zeroed touch, and read it as a browser does."""
    page = Page(port=0, threshold=0.78)
    run.sink_types = {page.destination: {Touch: (0,), Zeroed: (0,)}}
    await page.open(run)
    async with listening(page.url) as frames:
        yield page, frames
        await page.close()


async def first_with(frames: Frames, name: str) -> Any:
    """Return the first value of a name that is not empty."""
    return await anext(frame[name] async for frame in frames if frame.get(name))


def rows(time: Any, cells: int = 6) -> Zeroed:
    counts = np.full((len(time), cells), -7, np.int16)
    return Zeroed(time, counts, counts, counts < 0, finger=0)


async def test_a_browser_that_does_not_ask_costs_nothing_and_gets_the_last_30_s_later(run: Run) -> None:
    time = NOW + np.arange(50_000) * 10 * ms
    async with opened(run) as (page, slow), listening(page.url) as fast:
        await anext(slow)
        await anext(fast)
        received = list[float]()
        for part in np.split(time, 5):
            await page.write(rows(part))
            received += (await first_with(fast, "rows"))["touch 0"]["t"]
        late = (await first_with(slow, "rows"))["touch 0"]["t"]
        assert len(late) == 3001
        assert late[-1] == received[-1] == (time[-1] - run.start) / ms
        assert received == sorted(received)


async def test_a_browser_that_reads_nothing_does_not_hold_up_the_run(run: Run) -> None:
    async with opened(run) as (page, frames), ClientSession() as session:
        silent = await session.ws_connect(f"{page.url}/live", origin=page.url)
        for _ in range(1000):  # asks, and never reads
            await silent.send_str("")
        async with asyncio.timeout(PATIENCE):
            for k in range(12):  # 1 MB each, more than the sockets hold
                assert page.take(rows(NOW + (3000 * k + np.arange(3000)) * 10 * ms, cells=64))
                await first_with(frames, "rows")


async def test_the_end_of_a_run_is_sent_last(run: Run) -> None:
    async with opened(run) as (page, frames):
        await anext(frames)
        await page.write(slip(NOW, 1))
        run.error = "touch -> Zero: broken"
        closing = asyncio.create_task(page.close())
        await asyncio.sleep(0.1)  # this browser asks late
        *_, last = [frame async for frame in frames]
        assert last["end"] == {"error": "touch -> Zero: broken"}
        assert [event["onset"] for event in last["events"]] == [True]
        await closing
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection(*re.findall(r"//(.*):(\d+)", page.url)[0])
