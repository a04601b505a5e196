import asyncio

import pytest

from connectors import Metrics
from flows.cli.live_view import add_metrics
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from flows.graph.validation import problems
from flows.run.live_runner import LiveRunner
from operators import Debounce, Scores, Slips, Touch


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
