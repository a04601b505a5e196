"""A flow with a join and two derived streams, and recordings for it."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pytest

from flows.graph import Flow
from flows.graph.testing import TestSource
from flows.run.cluster.work_units import UnitResult, WorkUnit
from flows.run.cluster.worker import Worker
from operators import Align, Debounce, Label, Motion, Score, Touch, Zero, ms, s
from storage import Dataset, load_detector
from tests.flows.run.recorder import Recorder


@pytest.fixture
def new_recorder(tmp_path: Path) -> Callable[..., Recorder]:
    def build(session: str = "one") -> Recorder:
        return Recorder(tmp_path / "source", session)

    return build


@pytest.fixture
def folder(new_recorder: Callable[..., Recorder]) -> Path:
    """A session with two fingertips and 45 s."""
    recorder = new_recorder()
    recorder.record(45)
    return recorder.close()


def derive(out: Path, threshold: float = 0.5) -> Flow:
    """Declare a flow that stores raw touch, samples and slips."""
    flow, dataset = Flow("derive"), Dataset(out, part_span=15 * s, host="test")
    touch = flow.source(TestSource(Touch))
    zeroed = touch | Zero()
    samples = zeroed & flow.source(TestSource(Motion)) | Align() | Label(delay=70 * ms)
    samples.to(dataset)
    (samples | Score(load_detector("psd")) | Debounce(threshold=threshold)).to(dataset)
    touch.to(dataset)
    return flow


def processed(flow: Flow, units: Iterable[WorkUnit]) -> Iterator[tuple[UnitResult, list[list[UnitResult]]]]:
    """Process units as Flink does; yield the last result of each session, and all results by share."""
    worker, states, results = Worker(flow), dict[str, bytes](), dict[str, UnitResult]()
    for unit in units:
        states[unit.key], new = worker.process(states.get(unit.key), WorkUnit.from_line(unit.to_line()))
        for result in new:
            results[result.key] = UnitResult.from_line(result.to_line())
            shares = result.all_keys()
            if result.error or (shares and all(keys[-1] in results for keys in shares)):
                yield result, [[results[key] for key in keys] for keys in shares]
