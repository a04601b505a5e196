import re
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from types import new_class
from typing import Any, cast

import numpy as np
import pytest

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.graph.testing import TestSink, TestSource
from operators import (
    EVERY,
    Align,
    Batch,
    Debounce,
    DeviceClock,
    Join,
    Motion,
    Operator,
    OperatorError,
    Pool,
    Sample,
    Score,
    Scores,
    Slips,
    Touch,
    Zero,
    Zeroed,
    concat,
    ms,
    s,
    segment,
)
from operators.batch import Counts, Reals
from operators.detectors import Psd
from operators.fingertip import Fingertip, grid
from operators.operator import output_type
from operators.steps import Record, RowType, Steps
from tests.flows.run.live import Described, flow_of
from tests.operators import test_conformance as suite
from tests.storage.made import same

FILE = r"test_compiled_flow\.py"


def scores(*probabilities: float, start: int = 0, finger: int = EVERY) -> Scores:
    return Scores.rows(start + np.arange(len(probabilities)) * 10 * ms, probabilities, finger=finger)


def touch(*times: int, finger: int = EVERY) -> Touch:
    return Touch.rows(times, [[400 + finger] * 6] * len(times), 400 + finger, True, finger=finger)


def test_a_compiled_flow_lists_types_and_fingertips_of_each_sink() -> None:
    flow, one, other = Flow("pressed"), TestSink("one"), TestSink("other")
    probabilities = flow.source(TestSource(Scores, fingers=(1,)))
    slips = probabilities | Debounce()
    slips.to(one)
    (flow.source(TestSource(Scores, fingers=(0,))) | Debounce()).to(one)
    probabilities.to(one)
    slips.to(other)
    assert CompiledFlow(flow).sink_types == {
        one.destination: {Slips: (0, 1), Scores: (1,)},
        other.destination: {Slips: (1,)},
    }


class Forgetful(Operator[Scores, Scores]):
    def process(self, batch: Scores) -> Scores:
        return Scores(batch.time, batch.probability)


class Wrong(Operator[Scores, Scores]):
    def process(self, batch: Scores) -> Scores:
        return cast("Scores", None)


ONE = np.array([0])


@dataclass
class Returning(Operator[Scores, Scores]):
    """Returns columns of its own."""

    columns: Callable[[], tuple[Any, Any]]

    def process(self, batch: Scores) -> Scores:
        return Scores(*self.columns(), finger=batch.finger)


@pytest.mark.parametrize(
    ("operator", "message"),
    [
        (Returning(lambda: (ONE, np.ones(1, np.float32))), "Returning: Scores.probability: is float32, must"),
        (Returning(lambda: (np.array([3, 4, 2]), np.ones(3))), "Returning: Scores.time: decreases at row 2"),
        (Forgetful(), "Forgetful: ValueError: returned rows of fingertip -1, not 2: pass on finger="),
        (Wrong(), "Wrong: TypeError: returned NoneType, but declares Scores"),
    ],
    ids=["dtype", "order", "finger", "type"],
)
def test_an_operator_that_breaks_its_contract_is_named(
    operator: Operator[Scores, Scores], message: str
) -> None:
    compiled = CompiledFlow(flow_of(TestSource(Scores, fingers=(2,)), TestSink(), through=[operator]))
    with pytest.raises(OperatorError, match=re.escape(f"flow 'f': {message}")):
        compiled.push({compiled.entries[0]: scores(0.1, finger=2)})


def test_output_that_begins_before_the_end_of_the_last_batch_is_an_error() -> None:
    times = iter([90 * ms, 90 * ms, 40 * ms])
    backwards = Returning(lambda: (np.array([next(times)]), np.ones(1)))
    compiled = CompiledFlow(flow_of(TestSource(Scores), TestSink(), through=[backwards]))
    for _ in range(2):
        compiled.push({compiled.entries[0]: scores(0.1)})
    with pytest.raises(OperatorError, match=r"^flow 'f': Returning: Scores\.time: decreases by 50 ms betw"):
        compiled.push({compiled.entries[0]: scores(0.1)})


class Broken(Operator[Zeroed, Scores]):
    def process(self, batch: Zeroed) -> Scores:
        raise KeyError("limit")


class Strict(Operator[Zeroed, Scores]):
    def steps(self, *given: RowType) -> Steps:
        return Steps(step=too_high)


def too_high(settings: Record, state: Record, row: Record, out: Record) -> bool:
    raise KeyError("limit")


class Unknowing:
    name, length = "unknowing", 1

    def score(self, windows: Counts | Reals) -> Reals:
        raise KeyError("limit")


class UnknowingSteps(Unknowing):
    def steps(self, cells: int) -> Steps:
        return Steps(step=too_high)


@pytest.mark.parametrize(
    "operator",
    [Broken(), Strict(), Score(Unknowing()), Score(UnknowingSteps())],
    ids=["process", "steps", "detector", "streaming detector"],
)
def test_a_failing_operator_or_detector_is_named_with_its_line(operator: Operator[Zeroed, Scores]) -> None:
    flow = Flow("f")
    zeroed = flow.source(TestSource(Touch)) | Zero(baseline=400)
    (zeroed | Score(Psd())).to(TestSink())
    (zeroed | operator).to(TestSink())
    compiled, name = CompiledFlow(flow), type(operator).__name__
    with pytest.raises(OperatorError, match=rf"^flow 'f': {name}: KeyError: '?limit'? \({FILE}:\d+\)$"):
        compiled.pusher(compiled.entries[0])(touch(0))


class Unready(Operator[Scores, Scores]):
    def steps(self, *given: RowType) -> Steps:
        raise OSError("no weights")


def test_an_operator_that_cannot_be_prepared_is_named() -> None:
    flow = flow_of(TestSource(Scores), TestSink(), through=[Unready(), Debounce()])
    reason = r"Unready: OSError: no weights \(test_compiled_flow\.py:\d+\)$"
    with pytest.raises(OperatorError, match=rf"^flow 'f': {reason}"):
        CompiledFlow(flow)


def test_rows_are_released_though_the_arm_is_silent_and_all_inputs_come_from_operators(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(segment, "compiler", lambda: None)  # this flow takes 16 s to compile
    flow = Flow("f")
    zeroed = flow.source(TestSource(Touch)) | Zero(baseline=400)
    (zeroed & (flow.source(TestSource(Motion)) | DeviceClock()) | Align(wait=100 * ms)).to(TestSink())
    compiled = CompiledFlow(flow)
    pushed = [compiled.push({compiled.entries[0]: touch(time)}) for time in (0, 99 * ms, 100 * ms)]
    assert [len(deliveries) for deliveries in pushed] == [0, 0, 1]


def test_motion_that_comes_with_touch_of_one_fingertip_reaches_the_others() -> None:
    """As in a replay, in a time span in which one fingertip has no rows."""
    flow = Flow("f")
    zeroed = flow.source(TestSource(Touch, fingers=(0, 1))) | Zero(baseline=400)
    (zeroed & flow.source(TestSource(Motion)) | Align()).to(TestSink())
    compiled = CompiledFlow(flow)
    left, right, arm = compiled.entries
    compiled.push({right: touch(0, finger=1)})
    joined = [
        batch
        for _, batch in compiled.push({left: touch(0, finger=0), arm: Motion.rows([0, 8 * ms], 0, 1, 1)})
    ]
    assert [batch.finger for batch in joined] == [0, 1]


def test_an_empty_batch_needs_not_the_number_of_cells_of_the_fingertip() -> None:
    compiled = CompiledFlow(flow_of(TestSource(Touch), TestSink(), through=[Pool(gain=0.25)]))
    assert compiled.push({compiled.entries[0]: Touch.zeros(0, cells=9)}) == []


@dataclass
class HoldBack(Operator[Scores, Scores]):
    held: Scores = field(default_factory=Scores.empty, init=False)

    def process(self, batch: Scores) -> Scores:
        rows = concat(Scores, [self.held, batch])
        self.held = rows[-3:]
        return rows[:-3]


@dataclass
class Latest(Join[Scores, Scores, Scores]):
    newest: float = field(default=0.0, init=False)

    def process(self, left: Scores, right: Scores) -> Scores:
        self.newest = right.probability.item(-1) if len(right) else self.newest
        return replace(left, probability=left.probability + self.newest)


def test_a_join_sees_rows_that_an_operator_held_back_as_late_as_row_by_row() -> None:
    flow, given = Flow("late"), Scores.rows(np.arange(40) * 10 * ms, np.arange(40) / 100)
    stream = flow.source(TestSource(Scores))
    (stream & (stream | HoldBack()) | Latest()).to(TestSink())
    expected = [0.0, 0.01, 0.02, 0.03, 0.05, 0.07]
    for pieces in ([given], [given[:17], given[17:]], [given[i : i + 1] for i in range(40)]):
        compiled = CompiledFlow(flow)
        found: list[Any] = [
            batch for each in pieces for _, batch in compiled.push({compiled.entries[0]: each})
        ]
        assert concat(Scores, found).probability[:6].round(2).tolist() == expected


class AtMotion(Join[Touch, Motion, Touch]):
    def process(self, left: Touch, right: Motion) -> Touch:
        assert right.finger == EVERY
        cells = np.resize(left.counts, (len(right), left.cells))
        return Touch.rows(right.time, cells, cells, True, finger=left.finger)


def test_the_empty_batch_of_a_join_has_cells_and_fingertip_of_its_stream() -> None:
    flow = Flow("f")
    touch = flow.source(Described(Fingertip(grid(9), 100.0), fingers=(0, 1)))
    (touch & flow.source(TestSource(Motion)) | AtMotion()).to(TestSink())
    row = Touch.rows([1], np.zeros((1, 9)), 0, True, finger=0)
    found = outputs(CompiledFlow(flow), [{0: row}, {2: Motion.rows([5], 0, 1, 1)}])
    assert [(finger, each[-1].cells) for finger, each in found.items()] == [(0, 9), (1, 9)]


def passing(kind: type[Batch]) -> Operator[Any, Any]:
    """An operator of a user that passes batches on, as ``class Pass(Operator[Scores, Scores])``."""

    def fill(body: dict[str, Any]) -> None:
        body["process"] = lambda self, batch: batch

    base = cast("Any", Operator)[kind, kind]
    return cast("Operator[Any, Any]", new_class("Pass", (base,), exec_body=fill)())


def outputs(compiled: CompiledFlow, pushes: Iterable[dict[int, Batch]]) -> dict[int, list[Batch]]:
    """The batches for sinks by fingertip; those that are pushed have the number of their entry."""
    found = defaultdict[int, list[Batch]](list)
    for pushed in pushes:
        for _, batch in compiled.push({compiled.entries[i]: rows for i, rows in pushed.items()}):
            found[batch.finger].append(batch)
    for _, batch in compiled.flush():
        found[batch.finger].append(batch)
    return found


@suite.every
@pytest.mark.parametrize("cuts", [[], range(400)], ids=["at once", "one by one"])
def test_an_operator_among_those_of_users_gives_equal_bits(case: suite.Case, cuts: Iterable[int]) -> None:
    streams = case.streams(5, 200)
    flow = Flow("f")
    first, *others = (
        flow.source(TestSource(type(each), fingers=(each.finger,))) | passing(type(each)) for each in streams
    )
    joined = first & others[0] if others else first
    kind = output_type(type(case.step))
    (joined | cast("Any", case.step) | passing(kind)).to(TestSink())
    pushes = [dict(enumerate(piece)) for piece in suite.pieces(streams, cuts)]
    found = outputs(CompiledFlow(flow), pushes)
    expected = suite.run(case.step.reset_copy(), [streams])
    same(suite.joined(kind, found[streams[0].finger]), expected)


@pytest.mark.parametrize("rows", [1, 7, 300], ids=["one by one", "cut", "at once"])
def test_motion_that_passes_a_segment_of_its_own_joins_the_touch_of_each_fingertip(rows: int) -> None:
    flow = Flow("f")
    zeroed = flow.source(TestSource(Touch, fingers=(0, 1))) | Zero(baseline=400)
    (zeroed & (flow.source(TestSource(Motion)) | DeviceClock()) | Align()).to(TestSink())
    time = 10 * s + np.arange(300) * 8 * ms
    touches = [touch(*(time + finger * ms).tolist(), finger=finger) for finger in (0, 1)]
    late = np.random.default_rng(0).integers(0, 5, 300) * ms
    arm = Motion(time + late, time, np.cumsum(np.ones((300, 6)), axis=0) / 1e4, np.zeros((300, 6)))
    streams = [*touches, arm]
    pushes = [
        {i: stream[start : start + rows] for i, stream in enumerate(streams)} for start in range(0, 300, rows)
    ]
    found = outputs(CompiledFlow(flow), pushes)
    for each in touches:
        samples = Align().push(Zero(baseline=400).push(each), DeviceClock().push(arm))
        joined = concat(Sample, cast("list[Sample]", found[each.finger]))
        same(joined[: len(samples)], samples)
        assert len(joined) == 300
