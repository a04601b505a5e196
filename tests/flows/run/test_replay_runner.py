import asyncio
import pickle
from dataclasses import dataclass, field
from itertools import pairwise
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors import Replay
from flows.graph import Flow
from flows.graph.testing import TestRecording, TestSink, TestSource, run_virtually
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from flows.run.replay_runner import ReplayRunner, declaration, in_slices
from operators import (
    EVERY,
    Align,
    EndpointError,
    InputError,
    Label,
    Labelled,
    Motion,
    Operator,
    Score,
    Source,
    Touch,
    Zero,
    Zeroed,
    ms,
    s,
)
from operators.detectors import TRAINED
from storage.models import read_weights, shipped_path
from tests.flows.run.live import FaultySink, flow_of
from tests.storage.made import same


def recording(seconds: float = 5.0, finger: int = 0) -> TestRecording:
    rng, start = np.random.default_rng(0), 1_700_000_000 * s
    time = start + np.arange(int(seconds * 100)) * 10 * ms  # (n,)
    counts = rng.integers(300, 500, (len(time), 6)).astype(np.int16)
    touch = Touch(time, counts, counts, np.ones(counts.shape, np.bool_), finger=finger)
    time = start + 3 * ms + np.arange(int(seconds * 125)) * 8 * ms
    velocity = rng.normal(0, 0.01, (len(time), 6))
    return TestRecording("memory", [touch, Motion(time, time, velocity, np.full(velocity.shape, np.nan))])


def labelling(
    touch: Source[Touch] | None = None, motion: Source[Motion] | None = None
) -> tuple[Flow, TestSink]:
    flow, sink = Flow("labelling"), TestSink()
    zeroed = flow.source(touch or TestSource(Touch)) | Zero()
    (zeroed & flow.source(motion or TestSource(Motion)) | Align() | Label()).to(sink)
    return flow, sink


def test_a_live_run_equals_a_replay_of_the_same_rows() -> None:
    held = recording()
    full_flow, full = labelling()
    asyncio.run(ReplayRunner(full_flow, held, "full").execute())
    start = int(next(held.read(Touch, 0, 1)).time[0])
    live_flow, live = labelling(Replay(held, Touch), Replay(held, Motion))

    async def run_live() -> None:
        await LiveRunner(live_flow, "live", clock=LoopClock(start)).execute()

    run_virtually(run_live())
    assert [(sink.run.live, sink.run.recording) for sink in (full, live)] == [
        (False, "memory"),
        (True, "memory"),
    ]
    assert len(full.rows(Labelled, 0)) == 500
    same(full.rows(Labelled, 0), live.rows(Labelled, 0))


def test_a_stream_that_the_recording_lacks_is_named_and_an_empty_recording_is_an_error() -> None:
    flow, _ = labelling()
    touch_only = TestRecording("memory", recording().read(Touch, 0, 1000))
    with pytest.raises(InputError, match="memory: has no motion stream, which source 'motion' needs"):
        ReplayRunner(flow, touch_only, "x")
    empty = TestRecording("memory", [Touch.empty(), Motion.empty()])
    with pytest.raises(InputError, match="memory: is empty"):
        asyncio.run(ReplayRunner(flow, empty, "x").execute())


class ClosesWithError(FaultySink):
    async def close(self) -> None:
        await super().close()
        raise EndpointError("disk", "full")


class AwaitsCancelledTask(TestSink):
    async def close(self) -> None:
        task = asyncio.create_task(asyncio.sleep(1))
        task.cancel()
        await task


@pytest.mark.parametrize(
    ("sink", "error", "logged"),
    [
        (ClosesWithError("a"), "disk: full", []),
        (AwaitsCancelledTask("a"), "a task that it awaited was cancelled", []),
        (ClosesWithError("a", failures=[OSError("first failed")]), "first failed", ["a failed: disk: full"]),
    ],
)
def test_a_replay_fails_with_its_first_error_if_a_sink_cannot_be_closed_and_closes_the_others(
    sink: TestSink, error: str, logged: list[str], caplog: pytest.LogCaptureFixture
) -> None:
    last = TestSink()
    with pytest.raises((EndpointError, OSError, RuntimeError), match=error):
        asyncio.run(ReplayRunner(flow_of(TestSource(Touch), sink, last), recording(), "x").execute())
    assert last.closed == 1
    assert caplog.messages == logged


def test_a_replay_that_is_cancelled_is_not_complete() -> None:
    async def cancelled() -> None:
        task = asyncio.current_task()
        assert task
        task.cancel()
        await asyncio.sleep(0)

    sink = FaultySink(before_write=cancelled)
    runner = ReplayRunner(flow_of(TestSource(Touch), sink), recording(), "x")
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(runner.execute())
    assert (runner.run.error, sink.closed) == ("was interrupted", 1)


def test_two_sources_of_one_kind_take_the_fingertips_that_they_declare() -> None:
    flow = Flow("f")
    thumb, index = TestSink(), TestSink()
    flow.source(TestSource(Touch, fingers=(0,)), "thumb").to(thumb)
    flow.source(TestSource(Touch, fingers=(1,)), "index").to(index)
    both = TestRecording("both", (each for f in (0, 1) for each in recording(1, f).read(Touch, f)))
    asyncio.run(ReplayRunner(flow, both, "x").execute())
    assert len(thumb.rows(Touch, 0)) == len(index.rows(Touch, 1)) == 100


stamps = st.lists(st.integers(0, 50), max_size=20).map(lambda values: np.array(sorted(values), np.int64))


@given(st.lists(st.tuples(stamps, st.integers(1, 7)), min_size=1, max_size=3))
def test_slices_share_their_cuts_and_keep_every_row(streams: list[tuple[np.ndarray, int]]) -> None:
    flow = Flow("f")
    entries = {
        (flow.source(TestSource(Motion)).node, EVERY): [
            Motion(t, t, np.zeros((len(t), 6)), np.zeros((len(t), 6)))[i : i + size]
            for t in [times]
            for i in range(0, len(times), size)
        ]
        for times, size in streams
    }
    slices = list(in_slices({e: iter(b) for e, b in entries.items()}))
    for entry, batches in entries.items():
        whole = [t for batch in batches for t in batch.time.tolist()]
        assert [t for cut in slices if entry in cut for t in cut[entry].time.tolist()] == whole
    for earlier, later in pairwise(slices):
        assert max(b.time[-1] for b in earlier.values()) <= min(b.time[0] for b in later.values())


@dataclass
class Table(Operator[Zeroed, Zeroed]):
    """An operator with parameters of any kind."""

    value: Any = None
    hidden: Any = field(default=None, repr=False)

    def process(self, batch: Zeroed) -> Zeroed:
        return batch


class Detector:
    name, length = "mine", 5

    def __init__(self, value: Any, weights: float = 0.0) -> None:
        self.value, self._weights = value, np.array([weights])

    def score(self, windows: Any) -> Any:
        return np.zeros(len(windows))


def _halved(value: float) -> float:
    return value / 2


def trained(kind: str, shift: float = 0.0) -> Score:
    """A shipped detector, as if it were trained to another bias."""
    path = shipped_path(kind)
    weights, _ = read_weights(path, path.read_bytes())
    bias = weights["out/bias"]
    other = bias + np.arange(1, 1 + bias.size, dtype=np.float32) * np.float32(shift)
    return Score(TRAINED[kind]({**weights, "out/bias": other}))


LONG = np.zeros(2000)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (Table(Path("a/table.csv")), Table(Path("b/table.csv"))),
        (Table(LONG), Table(np.where(np.arange(2000) == 1000, 1e-10, LONG))),
        (Table(hidden=1), Table(hidden=2)),
        (Table(sin), Table(cos)),
        (Score(Detector(1)), Score(Detector(2))),
        (Score(Detector(1, 0.1)), Score(Detector(1, 0.2))),
        *((trained(kind), trained(kind, 0.1)) for kind in TRAINED),
    ],
)
def test_the_declaration_tells_parameters_apart_but_not_processes(
    one: Operator[Zeroed, Any], other: Operator[Zeroed, Any]
) -> None:
    def declared(operator: Operator[Zeroed, Any]) -> list[str]:
        return declaration(flow_of(TestSource(Zeroed), TestSink(), through=[operator]))

    again: Operator[Zeroed, Any] = pickle.loads(pickle.dumps(one))  # noqa: S301 - our own bytes
    assert declared(one) == declared(again) != declared(other)
    assert "0x" not in "".join(declared(Table(_halved)))
