"""Made-up traces and studies."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from flows.lab.experiments.lift_trial import LiftOutcome, lift
from flows.lab.experiments.rivals import Method
from flows.lab.experiments.study import Experiment, Outcome, Study, Trials
from flows.lab.experiments.tap_trial import TapOutcome, tap
from flows.lab.experiments.trial import Trace
from operators.batch import Reals

_T = np.arange(700) / 100  # s
_NAN = float("nan")

MakeStudy = Callable[..., Study]


@pytest.fixture
def make_trace() -> Callable[..., Trace]:
    """A trace of 7 s in which nothing happens except in the given columns."""
    zero, never = np.zeros(700), np.zeros(700, np.bool_)
    counts = np.zeros((700, 6), np.int16)
    calm = Trace(_T, counts, zero, zero + 1, zero + 1, zero, zero, zero, zero, never, never)

    def trace(**columns: Any) -> Trace:  # noqa: ANN401 - columns of several types
        return replace(calm, **columns)

    return trace


@pytest.fixture
def during() -> Callable[..., Reals]:
    """A column that is `value` within spans (s), else 0."""

    def column(*spans: tuple[float, float], value: float = 1.0) -> Reals:
        inside = np.zeros(700, np.bool_)
        for start, end in spans:
            inside |= (start - 1e-9 <= _T) & (end - 1e-9 > _T)
        return np.where(inside, value, 0.0)

    return column


@pytest.fixture
def make_study() -> MakeStudy:
    """A study of the outcomes by condition, method and object, each a sequence of trials."""

    def make(experiment: Experiment, outcomes: Mapping[tuple[str, Method, str], Sequence[Outcome]]) -> Study:
        rows = [
            {"condition": condition, "method": str(method), "object": name, "seed": 7 + number}
            | {"success": outcome.success, **asdict(outcome)}
            for (condition, method, name), each in outcomes.items()
            for number, outcome in enumerate(each)
        ]
        methods = tuple(dict.fromkeys(method for _, method, _ in outcomes))
        objects = tuple(dict.fromkeys(name for *_, name in outcomes))
        count = len(next(iter(outcomes.values())))
        frame = pl.DataFrame(rows, infer_schema_length=None).fill_nan(None)
        return Study(experiment, methods, Trials(count, 7, objects), frame)

    return make


def _outcomes(good: Outcome, bad: Outcome) -> dict[tuple[str, Method, str], Sequence[Outcome]]:
    """Two trials with a ball and a box: our rule fails once, with the ball, the other rule always."""
    ours, none = Method("psd"), Method("psd", "none")
    return {
        ("nominal", ours, "ball"): [good, bad],
        ("nominal", ours, "box"): [good, good],
        ("nominal", none, "ball"): [bad, bad],
        ("nominal", none, "box"): [bad, bad],
    }


@pytest.fixture
def lifts(make_study: MakeStudy) -> Study:
    """A study of the lift."""
    held, lost = (
        LiftOutcome("held", False, 3.0, -20.0, 1.5, 1.75),  # noqa: FBT003
        LiftOutcome("missed", True, 30.0, _NAN, _NAN, 0.5),  # noqa: FBT003
    )
    return make_study(lift, _outcomes(held, lost))


@pytest.fixture
def taps(make_study: MakeStudy) -> Study:
    """A study of the tap."""
    good = TapOutcome("registered", False, 2.0, -30.0, 2, 1, 0)  # noqa: FBT003
    bad = TapOutcome("too late", True, 4.0, -300.0, 2, 1, 1)  # noqa: FBT003
    return make_study(tap, _outcomes(good, bad))
