import asyncio
from collections.abc import AsyncIterator
from itertools import count

import numpy as np
import pytest
from aiohttp import ClientSession
from prometheus_client.parser import text_string_to_metric_families

from connectors import Metrics
from flows.cli.live_view import add_metrics
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from flows.graph.validation import problems
from flows.run.live_runner import LiveRunner
from operators import Clock, Debounce, Scores, Slips, Source, Touch


def test_the_metrics_take_slips_faults_scores_and_clocks_of_those_that_there_are() -> None:
    flow = Flow("slipping")
    (flow.source(TestSource(Scores)) | Debounce()).to(TestSink())
    add_metrics(flow, "9464")
    assert problems(flow) == []
    [node] = [node for node, sink in flow.sinks().items() if isinstance(sink, Metrics)]
    assert [parent.gives for parent in node.inputs] == [Slips, Scores]
    add_metrics(flow, "9464")
    [problem] = problems(flow)
    assert "metrics2: writes to http://127.0.0.1:9464, as does Debounce -> metrics" in str(problem)


def test_a_flow_of_touch_alone_has_metrics(capsys: pytest.CaptureFixture[str]) -> None:
    flow = Flow("raw")
    flow.source(TestSource(Touch)).to(TestSink())
    add_metrics(flow, "0")
    assert problems(flow) == []

    async def main() -> None:
        await LiveRunner(flow, "run1").execute()

    asyncio.run(main())
    assert capsys.readouterr().err.startswith("metrics: http://127.0.0.1:")


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
        flow, source, writes, again = Flow("slipping"), FailingOnce(), count(), asyncio.Event()

        async def hold() -> None:
            if next(writes):  # the second
                again.set()

        scores = flow.source(source, "touch")
        scores.to(TestSink(before_write=hold))
        (scores | Debounce(consecutive=1)).to(TestSink())
        add_metrics(flow, "0")
        [metrics] = [sink for sink in flow.sinks().values() if isinstance(sink, Metrics)]
        running = asyncio.create_task(LiveRunner(flow, "run1").execute())
        await again.wait()
        async with ClientSession() as session, session.get(metrics.url) as response:
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
