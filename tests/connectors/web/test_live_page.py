import asyncio
import re
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, TypeAlias

import pytest
from aiohttp import ClientSession

from connectors import Page
from operators.batch import ms, s
from operators.errors import EndpointError, ParameterError
from operators.ports import Run, SinkStatus, SourceStatus
from tests.connectors.web.reading import listening, slip, touched
from tests.waiting import until

Heard: TypeAlias = AsyncIterator[tuple[str, dict[str, Any]]]

NOW = 100 * s


@asynccontextmanager
async def opened(page: Page, run: Run) -> AsyncGenerator[tuple[Page, Heard]]:
    """A page that is open, and what a browser hears of it."""
    await page.open(run)
    async with listening(page.url) as heard:
        yield page, heard
        await page.close()


async def next_of(heard: Heard, name: str) -> dict[str, Any]:
    async for each, document in heard:
        if each == name:
            return document
    raise AssertionError(name)


def test_a_late_page_gets_the_kept_rows_and_then_new_ones(run: Run) -> None:
    async def main() -> None:
        page = Page(port=0, threshold=0.78)
        await page.open(run)
        await page.write(touched(NOW - 20 * ms, -5))
        await page.write(slip(NOW - 10 * ms, 1))
        async with listening(page.url) as heard:
            hello = await next_of(heard, "hello")
            assert (hello["session"], hello["flow"], hello["threshold"]) == ("run1", "live", 0.78)
            assert (hello["live"], hello["recording"], hello["start"]) == (True, None, 90_000)
            assert hello["touch"]["0"]["v"] == [[-5] * 6]
            assert hello["slipping"] == ["0"]
            assert [event["latency"] for event in hello["events"]] == [10.0]
            await page.write(touched(NOW, -9))
            frame = await next_of(heard, "frame")
            assert frame["touch"]["0"]["t"][-1] == 10_000
        await page.close()

    asyncio.run(main())


def test_an_impossible_number_of_a_message_gets_the_first_messages(run: Run) -> None:
    async def main() -> None:
        page, query = Page(port=0), {"session": "run1", "next": "9" * 5000}
        await page.open(run)
        async with ClientSession() as browser, browser.get(f"{page.url}/messages", params=query) as response:
            found = await response.json()
        assert [name for name, _ in found["messages"]] == ["hello", "report"]
        await page.close()

    asyncio.run(main())


def test_rows_that_arrive_together_share_a_frame(run: Run) -> None:
    async def main() -> None:
        async with opened(Page(port=0), run) as (page, heard):
            await next_of(heard, "hello")
            for finger in range(3):
                await page.write(touched(NOW, -1, finger=finger))
            await page.write(slip(NOW, 1))
            frame = await next_of(heard, "frame")
            assert sorted(frame["touch"]) == ["0", "1", "2"]
            assert frame["slipping"] == ["0"]

    asyncio.run(main())


def test_health_is_that_of_the_run(run: Run) -> None:
    run.sources["touch"] = SourceStatus(rows=500, newest=NOW - 30 * ms, up=False, error="unplugged")
    run.sinks["lab"], run.sinks["page"] = SinkStatus(rows=7, records=True), SinkStatus()

    async def main() -> None:
        async with opened(Page(port=0), run) as (_, heard):
            report = await next_of(heard, "report")
            assert report["sources"]["touch"]["state"] == "down"
            assert report["errors"] == {"touch": "unplugged"}
            assert report["recorders"] == ["lab"]
            assert report["sinks"]["lab"]["rows"] == 7
            run.sources["touch"].error = ""
            assert (await next_of(heard, "report"))["errors"] == {"touch": None}  # a second later

    asyncio.run(main())


def test_the_end_of_a_run_is_sent_last(run: Run) -> None:
    async def main() -> list[str]:
        page = Page(port=0)
        await page.open(run)
        names = list[str]()
        async with listening(page.url) as heard:
            await next_of(heard, "hello")
            await page.write(slip(NOW, 1))
            run.error = "touch -> Zero: broken"
            closing = asyncio.create_task(page.close())
            async for name, document in heard:
                names.append(name)
                if name == "end":
                    assert document["error"] == "touch -> Zero: broken"
                    assert document["recorders"] == []
            await closing
        return names

    assert asyncio.run(main())[-2:] == ["frame", "end"]


def test_the_end_has_the_final_count_of_a_slow_recorder(run: Run) -> None:
    recorder = run.sinks["dataset"] = SinkStatus(rows=7, queued=1, records=True)

    async def record() -> None:
        await asyncio.sleep(0.15)
        recorder.rows, recorder.queued = 9, 0

    async def main() -> dict[str, Any]:
        page = Page(port=0)
        await page.open(run)
        async with listening(page.url) as heard:
            await next_of(heard, "hello")
            recording, closing = asyncio.create_task(record()), asyncio.create_task(page.close())
            end = await next_of(heard, "end")
            await asyncio.gather(recording, closing)
        return end

    end = asyncio.run(main())
    assert end["recorders"] == ["dataset"]
    assert end["sinks"]["dataset"]["rows"] == 9


def test_without_a_browser_nothing_is_sent_and_closing_is_clean(run: Run) -> None:
    async def main() -> None:
        page = Page(port=0)
        await page.open(run)
        await page.write(touched(NOW, -1))
        await page.close()
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection(*re.findall(r"//(.*):(\d+)", page.url)[0])

    asyncio.run(main())


def test_without_a_browser_closing_waits_for_no_recorder(run: Run) -> None:
    run.sinks["dataset"] = SinkStatus(rows=7, queued=1, records=True)  # never done

    async def main() -> None:
        page = Page(port=0)
        await page.open(run)
        closing = asyncio.create_task(page.close())
        for _ in range(50):  # turns of the event loop, in which no time is waited
            await asyncio.sleep(0)
        assert closing.done()

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


def test_two_pages_have_two_destinations() -> None:
    assert Page().destination == "http://127.0.0.1:8765"
    assert Page(80, "::1").destination == "http://[::1]:80"


def test_a_report_that_fails_is_logged_at_once_and_raised_when_the_page_closes(
    run: Run, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(_: Page) -> None:
        raise KeyError("planted")

    async def main() -> None:
        page = Page(port=0)
        await page.open(run)
        with monkeypatch.context() as patch:
            patch.setattr(Page, "_judged", fail)
            await until(lambda: "the health report has failed: KeyError: 'planted'" in caplog.text)
        with pytest.raises(EndpointError, match="the health report has failed"):
            await page.close()

    asyncio.run(main())
