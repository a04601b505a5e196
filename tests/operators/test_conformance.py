"""Conformance of every public operator and join: the invariant and the further requirements."""

import inspect
import pickle
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final, TypeAlias, TypeVar, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import operators
from operators import (
    SLIP,
    STATIC,
    UNKNOWN,
    Align,
    Batch,
    Debounce,
    DeviceClock,
    Grip,
    Health,
    Join,
    Label,
    Labelled,
    MaskLifted,
    Motion,
    Operator,
    Pool,
    Resample,
    Sample,
    Score,
    Scores,
    StepGrip,
    Touch,
    Window,
    Zero,
    Zeroed,
    concat,
    ms,
    s,
    segment,
)
from operators.batch import Counts, Reals, Times
from operators.detectors import Psd, Tcn, tcn
from operators.operator import AnyOperator, output_type
from storage import load_detector
from tests.storage.made import same

Value = TypeVar("Value")
SomeTouch = TypeVar("SomeTouch", bound=Touch)
Make: TypeAlias = Callable[[np.random.Generator, int], Batch]
Streams: TypeAlias = tuple[Batch, ...]

_FINGER: Final = 3


# --- streams: jitter, duplicates, gaps, late rows, NaN, cells that fail, wrong bits ----------------------


def _times(rng: np.random.Generator, rows: int, period: int) -> Times:
    steps = [0, 1, period // 2, period, 4 * period, 60 * period, -period]
    start = 1_700_000_000 * s + rng.integers(0, 100) * ms
    return start + np.cumsum(rng.choice(steps, rows, p=[0.1, 0.02, 0.2, 0.6, 0.04, 0.01, 0.03]))


def _held(rng: np.random.Generator, choices: Sequence[float], shape: tuple[int, int], rows: int) -> Reals:
    """Values that each last for some rows."""
    length, width = shape
    return np.repeat(rng.choice(choices, (length // rows + 1, width)), rows, axis=0)[:length]


def _touch(kind: type[SomeTouch]) -> Callable[[np.random.Generator, int], SomeTouch]:
    def make(rng: np.random.Generator, rows: int) -> SomeTouch:
        shape = (rows, 6)
        mode = _held(rng, range(6), shape, 40)
        noise = _held(rng, (600, 640), shape, 150) + rng.integers(-1, 2, shape)
        loaded, floored = noise + rng.integers(-50, 50, shape), rng.integers(0, 12, shape)
        counts = np.select([mode == 1, mode == 2, mode == 3], [loaded, floored, 500], noise).astype(np.int16)
        counts ^= (np.int16(1) << rng.integers(0, 10, shape, np.int16)) * (rng.random(shape) < 0.005)
        valid = (mode != 4) & ((mode != 5) | (rng.random(shape) < 0.5))
        temperature = rng.integers(400, 500, shape).astype(np.int16)
        return kind(_times(rng, rows, 10 * ms), counts, temperature, valid, finger=_FINGER)

    return make


def _vectors(rng: np.random.Generator, rows: int, scales: Sequence[float]) -> Reals:
    vectors: Reals = rng.normal(size=(rows, 6)) * rng.choice(scales, (rows, 1))
    return vectors


def _motion(rng: np.random.Generator, rows: int) -> Motion:
    time = _times(rng, rows, 8 * ms)
    velocity = _vectors(rng, rows, (0, 1e-3, 0.05, 0.05, 0.3, np.nan, np.inf))
    return Motion(time, time - 5 * ms, velocity, _vectors(rng, rows, (0, 1e-9, 1, 1, 3, np.nan)))


def _clocked(rng: np.random.Generator, rows: int) -> Motion:
    """An arm whose controller restarts, drifts and reports late."""
    motion = _motion(rng, rows)
    up = np.cumsum(rng.choice([0, 8 * ms, 9 * ms, 800 * ms, 9 * s], rows, p=[0.02, 0.8, 0.1, 0.06, 0.02]))
    restarts = np.maximum.accumulate(np.where(rng.random(rows) < 0.01, up, 0))
    late = rng.integers(0, 20 * ms, rows)
    time = _times(rng, rows, 0) + up + up // 20_000 + late  # 50 ppm
    return Motion(
        np.where(rng.random(rows) < 0.97, np.maximum.accumulate(time), time),
        up - restarts,
        motion.velocity,
        motion.pose,
    )


def _sample(rng: np.random.Generator, rows: int) -> Sample:
    touch, motion = _touch(Zeroed)(rng, rows), _motion(rng, rows)
    matched = np.isfinite(motion.velocity[:, 0])
    values = touch.counts, touch.temperature, touch.valid, motion.velocity, motion.pose
    return Sample(touch.time, *values, matched, finger=_FINGER)


def _labelled(rng: np.random.Generator, rows: int) -> Labelled:
    """Samples about a plane at z = 0, with any label."""
    sample = _sample(rng, rows)
    values = sample.counts, sample.temperature, sample.valid, sample.velocity, sample.pose, sample.matched
    label = rng.choice([SLIP, STATIC, UNKNOWN], rows).astype(np.int8)
    return Labelled(sample.time, *values, np.abs(sample.velocity[:, 0]), label, finger=_FINGER)


def _scores(rng: np.random.Generator, rows: int) -> Scores:
    level = _held(rng, (0.1, 0.1, 0.5, 0.9, 0.9, np.nan), (rows, 1), 3)[:, 0]
    return Scores(_times(rng, rows, 10 * ms), level - rng.random(rows) / 20, finger=_FINGER)


# --- the table: a new operator or join needs a line here -------------------------------------------------


class _Spread:
    name, length = "spread", 9

    def score(self, windows: Counts | Reals) -> Reals:
        spread: Reals = np.ptp(windows, axis=(1, 2)) / 2000
        return spread


def _tcn() -> Tcn:
    rng = np.random.default_rng(0)
    sizes = tcn.shapes(taps=3, filters=5, units=4, blocks=2)
    weights = {name: rng.normal(size=shape) / 3 for name, shape in sizes.items()}
    scales = {"position_scale": np.array([8.0]), "step_scale": np.array([1.5])}
    return Tcn(weights | scales | {"dilations": np.array([1, 3])})


@dataclass(frozen=True)
class Case:
    step: AnyOperator
    inputs: tuple[Make, ...]

    def streams(self, seed: int, rows: int) -> Streams:
        return tuple(make(np.random.default_rng([seed, i]), rows) for i, make in enumerate(self.inputs))


CASES: Final = [
    Case(Zero(scans=30), (_touch(Touch),)),
    Case(Zero(baseline=(600, 601, 602, 603, 604, 605)), (_touch(Touch),)),
    Case(Zero(), (_touch(Zeroed),)),
    Case(Align(), (_touch(Zeroed), _motion)),
    Case(Align(how="previous", within=5 * ms, keep=100 * ms), (_touch(Zeroed), _motion)),
    Case(Align(how="previous", wait=0, keep=100 * ms), (_touch(Zeroed), _motion)),
    Case(Align(how="nearest", within=10 * ms, wait=10 * ms, keep=100 * ms), (_touch(Zeroed), _motion)),
    Case(DeviceClock(), (_clocked,)),
    Case(DeviceClock(window=2 * s, jump=100 * ms), (_clocked,)),
    Case(DeviceClock(), (_motion,)),
    Case(Label(), (_sample,)),
    Case(Label(rotation=np.inf), (_sample,)),
    Case(Label(delay=37 * ms), (_sample,)),
    Case(Label(delay=-40 * ms), (_sample,)),
    Case(MaskLifted((0, 0, 0, 0, 0, 0)), (_labelled,)),
    Case(MaskLifted((0.1, -0.2, 0.3, 0, 1.5, 0.5)), (_labelled,)),
    Case(Pool(((0, 1), (2,), (5, 4, 3)), gain=-1.7), (_touch(Touch),)),
    Case(Pool(gain=0.25), (_touch(Touch),)),
    Case(Resample(), (_touch(Touch),)),
    Case(Resample(rate=17, gap=300 * ms), (_touch(Touch),)),
    Case(Resample(rate=333.3, gap=25 * ms), (_touch(Touch),)),
    Case(Resample(rate=50), (_labelled,)),
    Case(Window(length=7, hop=3), (_touch(Touch),)),
    Case(Window(length=3, hop=10), (_touch(Zeroed),)),
    Case(Score(_Spread()), (_touch(Zeroed),)),
    Case(Score(Psd()), (_touch(Zeroed),)),
    Case(Score(load_detector("paper_tcn")), (_touch(Zeroed),)),
    Case(Score(load_detector("frequency_cnn")), (_touch(Zeroed),)),
    Case(Score(_tcn()), (_touch(Zeroed),)),
    Case(Debounce(), (_scores,)),
    Case(Debounce(threshold=0.88, consecutive=3, release=1), (_scores,)),
    Case(Grip(), (_scores,)),
    Case(Grip(max_force=0.7, settle=0, latency=50 * ms, release_rate=5.0), (_scores,)),
    Case(StepGrip(settle=50 * ms), (_scores,)),
    Case(Health(), (_touch(Touch),)),
    Case(Health(dead_after=30 * ms, stuck_after=50 * ms), (_touch(Zeroed),)),
    Case(Health(dead_after=30 * ms, stuck_after=50 * ms, clear_after=40 * ms), (_touch(Touch),)),
]

every = pytest.mark.parametrize("case", CASES, ids=lambda case: repr(case.step).split(" object")[0])
seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(0, 400)
cuts = st.one_of(
    st.lists(st.integers(0, 400), max_size=12),  # between equal cuts lie empty batches
    st.just(list(range(400))),  # row by row, as in a live run
)


def pieces(streams: Streams, cuts: Iterable[int]) -> list[Streams]:
    """One stream cut anywhere; two at common instants, as a replay gives them."""
    if len(streams) == 1:
        places = [[0, *sorted(min(cut, len(streams[0])) for cut in cuts), len(streams[0])]]
    else:
        seen = [np.maximum.accumulate(stream.time) for stream in streams]
        stamps = np.sort(np.concatenate(seen))
        instants = [stamps[cut] for cut in sorted(cuts) if cut < len(stamps)]
        places = [[0, *time.searchsorted(instants).tolist(), len(time)] for time in seen]
    parts = [
        [stream[start:stop] for start, stop in pairwise(place)]
        for stream, place in zip(streams, places, strict=True)
    ]
    return list(zip(*parts, strict=True))


def _kept(stream: Batch) -> Batch:
    """The rows that are not late."""
    return stream[stream.time >= np.maximum.accumulate(stream.time)]


def _push(step: AnyOperator, piece: Streams) -> Batch:
    result: Batch = cast("Any", step).push(*piece)
    return result


def run(step: AnyOperator, pieces: Iterable[Streams]) -> Batch:
    results = [_push(step, piece) for piece in pieces]
    results.append(cast("Any", step).flush())
    return joined(output_type(type(step)), results)


def joined(kind: type[Batch], results: Sequence[Batch]) -> Batch:
    """All rows, with the columns of a subtype."""
    return concat(next((type(each) for each in results if len(each)), kind), results)


def _pickled(value: Value) -> Value:
    return cast("Value", pickle.loads(pickle.dumps(value)))  # noqa: S301 our own bytes


# --- the invariant ----------------------------------------------------------------------------------------


@every
@given(seed=seeds, rows=sizes, cuts=cuts)
def test_cutting_the_input_anywhere_changes_nothing(
    case: Case, seed: int, rows: int, cuts: list[int]
) -> None:
    """Late rows are dropped and counted, rows of one stamp kept; no input or earlier output is modified.

    The output is in order: `CompiledFlow` does not look for late rows between operators.
    """
    streams, step, clean = case.streams(seed, rows), case.step.reset_copy(), case.step.reset_copy()
    kept, copies = tuple(_kept(stream) for stream in streams), _pickled(streams)
    kind, results = output_type(type(step)), [_push(step, piece) for piece in pieces(streams, cuts)]
    pushed = _pickled(joined(kind, results))
    found = joined(kind, [*results, cast("Any", step).flush()]).check_order()
    same(found, run(clean, [kept]))
    assert step.late == sum(map(len, streams)) - sum(map(len, kept))
    assert clean.late == 0
    _push(step, tuple(replace(stream, time=stream.time + 10 * s) for stream in streams))
    for now, then in zip([*streams, joined(kind, results)], [*copies, pushed], strict=True):
        same(now, then)


@pytest.mark.parametrize("align", [case.step for case in CASES if isinstance(case.step, Align)], ids=repr)
@given(seed=seeds, rows=sizes)
def test_whichever_stream_lags_within_the_wait_the_join_is_equal(align: Align, seed: int, rows: int) -> None:
    rng = np.random.default_rng(seed)
    left, right = _kept(_touch(Zeroed)(rng, rows)), _kept(_motion(rng, rows))
    lags = align.wait, align.wait - (0 if align.how == "previous" else align.within)
    arrivals = [
        np.maximum.accumulate(stream.time + rng.integers(0, lag + 1, len(stream)))
        for stream, lag in zip((left, right), lags, strict=True)
    ]
    touch = np.arange(len(left) + len(right)) < len(left)
    order = np.lexsort((touch, np.concatenate(arrivals)))  # of two that arrive together, motion comes first
    one_by_one: list[Streams] = [
        (left[row : row + 1], right[:0]) if row < len(left) else (left[:0], right[row - len(left) :][:1])
        for row in order.tolist()
    ]
    same(run(align.reset_copy(), one_by_one), run(align.reset_copy(), [(left, right)]))


@every
def test_steps_give_the_same_bits_compiled_and_as_plain_python(
    case: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    streams = [case.streams(seed, 300) for seed in range(2)]
    compiled = [run(case.step.reset_copy(), [each]) for each in streams]
    monkeypatch.setattr(segment, "compiler", lambda: None)
    for each, expected in zip(streams, compiled, strict=True):
        same(run(case.step.reset_copy(), [each]), expected)


# --- what else every one of them owes --------------------------------------------------------------------


def test_every_public_operator_and_join_is_in_the_table() -> None:
    public = [getattr(operators, name) for name in operators.__all__]
    steps = {kind for kind in public if inspect.isclass(kind) and issubclass(kind, AnyOperator)}
    concrete = {kind for kind in steps if not inspect.isabstract(kind)} - {Operator, Join}
    assert concrete == {type(case.step) for case in CASES}


@every
def test_a_reset_copy_has_the_parameters_and_no_state(case: Case) -> None:
    streams, step = case.streams(2, 300), case.step.reset_copy()
    found = run(step, [streams])
    again = step.reset_copy()
    assert (repr(again), again.late) == (repr(step), 0)
    same(run(again, [streams]), found)


@every
def test_the_state_does_not_grow_with_the_input(case: Case) -> None:
    """What consists of steps has a state of fixed size."""
    streams = tuple(_kept(stream) for stream in case.streams(1, 10_000))
    for away in [None, *range(len(streams))]:
        step, sizes = case.step.reset_copy(), list[int]()
        came = tuple(stream[:0] if i == away else stream for i, stream in enumerate(streams))
        for piece in pieces(came, range(0, 10_000, 97)):
            _push(step, piece)
            sizes.append(len(pickle.dumps(step)))
        half = len(sizes) // 2
        assert max(sizes[half:]) < 1.5 * max(sizes[:half]) + 1000
