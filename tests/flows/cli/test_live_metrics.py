import asyncio
from collections.abc import AsyncIterator
from itertools import count

import numpy as np
from aiohttp import ClientSession
from prometheus_client.parser import text_string_to_metric_families

from connectors import Metrics
from flows.cli.live_view import add_metrics
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from flows.graph.validation import problems
from flows.run.live_runner import LiveRunner
from operators import Clock, Debounce, Scores, Slips, Source, Touch


def slipping() -> Flow:
    flow = Flow("slipping")
    scores = flow.source(TestSource(Scores, [Scores(np.arange(4), np.array([0.1, 0.9, 0.9, 0.9]))]))
    (scores | Debounce()).to(TestSink())
    return flow


def test_the_metrics_take_slips_faults_scores_and_clocks() -> None:
    flow = slipping()
    add_metrics(flow, "0")
    assert problems(flow) == []
    [node] = [node for node in flow.nodes if isinstance(node.part, Metrics)]
    assert [parent.gives for parent in node.inputs] == [Slips, Scores]


def test_a_flow_without_slips_has_metrics() -> None:
    flow, heard = Flow("scored"), list[str]()
    flow.source(TestSource(Scores, [Scores(np.arange(4), np.full(4, 0.1))])).to(TestSink())
    add_metrics(flow, "0", heard.append)
    assert problems(flow) == []

    async def main() -> None:
        await LiveRunner(flow, "run1").execute()

    asyncio.run(main())
    assert len(heard) == 1


def test_two_metrics_at_one_address_are_an_error() -> None:
    flow = Flow("scored")
    flow.source(TestSource(Touch)).to(TestSink())
    add_metrics(flow, "9464")
    add_metrics(flow, "9464")
    [problem] = problems(flow)
    assert "metrics2: writes to http://127.0.0.1:9464, as does metrics" in str(problem)


class FailingOnce(Source[Scores]):
    """Yields a slip, fails, yields another, and ends after the metrics were requested."""

    def __init__(self) -> None:
        self.asked, self._failed = asyncio.Event(), False

    @property
    def kind(self) -> type[Scores]:
        return Scores

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        time = np.array([clock.now()])
        yield Scores(time, np.array([0.9]))
        if not self._failed:
            self._failed = True
            raise OSError("unplugged")
        await self.asked.wait()


def test_a_live_run_serves_its_metrics() -> None:
    async def main() -> dict[str, float]:
        flow, source, urls = Flow("slipping"), FailingOnce(), list[str]()
        writes, again = count(), asyncio.Event()

        async def hold() -> None:
            if next(writes):  # the second
                again.set()

        scores = flow.source(source, "touch")
        scores.to(TestSink(before_write=hold))
        (scores | Debounce(consecutive=1)).to(TestSink())
        add_metrics(flow, "0", urls.append)
        running = asyncio.create_task(LiveRunner(flow, "run1").execute())
        await again.wait()
        async with ClientSession() as session, session.get(urls[0]) as response:
            text = await response.text()
        source.asked.set()
        await running
        families = text_string_to_metric_families(text)
        return {sample.name: sample.value for each in families for sample in each.samples}

    found = asyncio.run(main())
    assert found["slipflow_source_rows_total"] == 2
    assert found["slipflow_source_failures_total"] == 1
    assert found["slipflow_source_gaps_total"] == 1
    assert found["slipflow_slip_latency_seconds_count"] == 1
