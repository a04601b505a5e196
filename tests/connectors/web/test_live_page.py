import asyncio
import re
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, TypeAlias

import numpy as np
import pytest
from aiohttp import ClientSession, WSServerHandshakeError

from connectors import Page
from connectors.web.access import TOKEN
from operators.batch import Zeroed, ms, s
from operators.errors import EndpointError, ParameterError
from operators.ports import Run, SinkStatus, SourceStatus
from tests.connectors.web.reading import listening, slip, touched
from tests.waiting import PATIENCE

Frames: TypeAlias = AsyncIterator[dict[str, Any]]

NOW = 100 * s


@asynccontextmanager
async def opened(page: Page, run: Run) -> AsyncGenerator[tuple[Page, Frames]]:
    """Open a page, and read it as a browser does."""
    await page.open(run)
    async with listening(page.url) as frames:
        yield page, frames
        await page.close()


async def first_with(frames: Frames, name: str) -> Any:  # noqa: ANN401 - of JSON
    """Return the first value of a name that is not empty."""
    return await anext(frame[name] async for frame in frames if frame.get(name))


def test_a_late_page_gets_the_kept_rows_and_then_new_ones(run: Run) -> None:
    async def main() -> None:
        page = Page(port=0, threshold=0.78)
        await page.open(run)
        await page.write(touched(NOW - 20 * ms, -5))
        await page.write(slip(NOW - 10 * ms, 1))
        async with listening(page.url) as frames:
            frame = await anext(frames)
            about = frame["run"]
            assert (about["session"], about["flow"], about["threshold"]) == ("run1", "live", 0.78)
            assert (about["recording"], about["start"]) == (None, 90_000)
            assert frame["rows"]["touch"]["0"]["v"] == [[-5] * 6]
            assert frame["slipping"] == ["0"]
            assert [event["latency"] for event in frame["events"]] == [10.0]
            await page.write(touched(NOW, -9))
            frame = await anext(frames)
            assert frame["rows"]["touch"]["0"]["t"] == [10_000]
            assert (frame["events"], "run" in frame) == ([], False)
        await page.close()

    asyncio.run(main())


def test_rows_that_arrive_together_share_a_frame(run: Run) -> None:
    async def main() -> None:
        async with opened(Page(port=0), run) as (page, frames):
            await anext(frames)
            for finger in range(3):
                await page.write(touched(NOW, -1, finger=finger))
            await page.write(slip(NOW, 1))
            frame = await anext(frames)
            assert sorted(frame["rows"]["touch"]) == ["0", "1", "2"]
            assert frame["slipping"] == ["0"]

    asyncio.run(main())


def test_a_browser_that_does_not_ask_costs_nothing_and_gets_the_last_30_s_later(run: Run) -> None:
    rows = 50_000
    time = NOW + np.arange(rows) * 10 * ms
    counts = np.full((rows, 6), -7, np.int16)

    async def main() -> None:
        async with opened(Page(port=0), run) as (page, slow), listening(page.url) as fast:
            await anext(slow)
            await anext(fast)
            received = list[float]()
            for begin in range(0, rows, 10_000):
                part = slice(begin, begin + 10_000)
                await page.write(Zeroed(time[part], counts[part], counts[part], counts[part] < 0, finger=0))
                received += (await first_with(fast, "rows"))["touch"]["0"]["t"]
            late = (await first_with(slow, "rows"))["touch"]["0"]["t"]
            assert len(late) == 3001
            assert late[-1] == received[-1] == (time[-1] - run.start) / ms
            assert received == sorted(received)

    asyncio.run(main())


def test_a_browser_that_reads_nothing_does_not_hold_up_the_run(run: Run) -> None:
    counts = np.full((3000, 64), -7, np.int16)

    async def main() -> None:
        async with opened(Page(port=0), run) as (page, frames), ClientSession() as session:
            silent = await session.ws_connect(f"{page.url}/live", origin=page.url)
            for _ in range(1000):  # asks, and never reads
                await silent.send_str("")
            async with asyncio.timeout(PATIENCE):
                for k in range(50):
                    time = NOW + (3000 * k + np.arange(3000)) * 10 * ms
                    assert page.take(Zeroed(time, counts, counts, counts < 0, finger=0))
                    await first_with(frames, "rows")

    asyncio.run(main())


def test_health_is_that_of_the_run(run: Run) -> None:
    run.sources["touch"] = SourceStatus(rows=500, newest=NOW - 30 * ms, up=False, error="unplugged")
    run.sinks["lab"], run.sinks["page"] = SinkStatus(rows=7, records=True), SinkStatus()

    async def main() -> None:
        async with opened(Page(port=0), run) as (_, frames):
            report = await first_with(frames, "report")
            assert report["sources"]["touch"]["state"] == "down"
            assert report["errors"] == {"touch": "unplugged"}
            assert report["recorders"] == ["lab"]
            assert report["sinks"]["lab"]["rows"] == 7
            run.sources["touch"].error = ""
            assert (await first_with(frames, "report"))["errors"] == {"touch": None}  # a second later

    asyncio.run(main())


def test_the_end_of_a_run_is_sent_last(run: Run) -> None:
    async def main() -> None:
        async with opened(Page(port=0), run) as (page, frames):
            await anext(frames)
            await page.write(slip(NOW, 1))
            run.error = "touch -> Zero: broken"
            closing = asyncio.create_task(page.close())
            *_, last = [frame async for frame in frames]
            assert last["end"] == {"error": "touch -> Zero: broken"}
            assert [event["onset"] for event in last["events"]] == [True]
            await closing
            with pytest.raises(ConnectionRefusedError):
                await asyncio.open_connection(*re.findall(r"//(.*):(\d+)", page.url)[0])

    asyncio.run(main())


@pytest.mark.parametrize("origin", [None, "http://evil.example"])
def test_pages_of_other_sites_cannot_listen(run: Run, origin: str | None) -> None:
    async def main() -> None:
        async with opened(Page(port=0), run) as (page, _), ClientSession() as session:
            with pytest.raises(WSServerHandshakeError, match="403"):
                await session.ws_connect(f"{page.url}/live", origin=origin)

    asyncio.run(main())


def test_listening_needs_the_token(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    token = "0123456789abcdef"  # noqa: S105 - of this test
    monkeypatch.setenv(TOKEN, token)

    async def main() -> None:
        page = Page(port=0)
        await page.open(run)
        async with ClientSession() as session:
            with pytest.raises(WSServerHandshakeError, match="403"):
                await session.ws_connect(f"{page.url}/live", origin=page.url)
            headers = {"Authorization": f"Bearer {token}"}
            async with session.ws_connect(f"{page.url}/live", origin=page.url, headers=headers) as socket:
                await socket.send_str("")
                assert (await socket.receive_json())["run"]["session"] == "run1"
        await page.close()

    asyncio.run(main())


def test_a_busy_default_port_is_replaced_but_a_given_one_is_an_error(run: Run) -> None:
    async def main() -> None:
        urls = list[str]()
        first, second = Page(opened=urls.append), Page(opened=urls.append)
        await first.open(run)
        await second.open(run)
        assert len(set(urls)) == 2
        port = int(urls[0].rpartition(":")[2])
        with pytest.raises(EndpointError, match=f"http://127.0.0.1:{port}: cannot serve the page"):
            await Page(port).open(run)
        await first.close()
        await second.close()

    asyncio.run(main())


@pytest.mark.parametrize("wrong", [{"port": 70_000}, {"port": -1}, {"threshold": 1.5}])
def test_parameters_out_of_range_are_rejected(wrong: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=f"Page: {next(iter(wrong))}"):
        Page(**wrong)


def test_other_machines_need_a_token(run: Run) -> None:
    with pytest.raises(ParameterError, match="SLIPFLOW_PAGE_TOKEN"):
        asyncio.run(Page(0, "192.0.2.1").open(run))
