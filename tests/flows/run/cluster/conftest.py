"""A flow with a join and two derived streams, and recordings for it."""

from collections.abc import Callable
from pathlib import Path

import pytest

from flows.graph import Flow
from flows.graph.testing import TestSource
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
    (zeroed & flow.source(TestSource(Motion)) | Align() | Label(delay=70 * ms)).to(dataset)
    (zeroed | Score(load_detector("psd")) | Debounce(threshold=threshold)).to(dataset)
    touch.to(dataset)
    return flow
