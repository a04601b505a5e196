"""Made-up traces and results."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flows.lab.experiments.lift_ablation import Ablation, Budget
from flows.lab.experiments.lift_trial import LiftEnding, LiftOutcome
from flows.lab.experiments.study import Method, Result, Results, Trials
from flows.lab.experiments.tap_trial import TapOutcome
from flows.lab.experiments.trial import Conditions, Trace
from operators.batch import Reals

_T = np.arange(600) / 100  # s


@pytest.fixture
def make_trace() -> Callable[..., Trace]:
    """A trace of 6 s in which nothing happens except in the given columns."""
    zero, never = np.zeros(600), np.zeros(600, np.bool_)
    counts = np.zeros((600, 6), np.int16)
    calm = Trace(_T, counts, zero, zero + 1, zero + 1, zero, zero, zero, zero, never, never)

    def trace(**columns: Any) -> Trace:  # noqa: ANN401 - columns of several types
        return replace(calm, **columns)

    return trace


@pytest.fixture
def during() -> Callable[..., Reals]:
    """A column that is `value` within spans (s), else 0."""

    def column(*spans: tuple[float, float], value: float = 1.0) -> Reals:
        inside = np.zeros(600, np.bool_)
        for start, end in spans:
            inside |= (start - 1e-9 <= _T) & (end - 1e-9 > _T)
        return np.where(inside, value, 0.0)

    return column


@pytest.fixture
def make_ablation() -> Callable[..., Ablation]:
    """An ablation of one method, by default of ten trials with a ball; all trials are equal."""

    def make(
        *,
        firm: float,
        ending: LiftEnding = "held",
        lost: bool = False,
        late: LiftEnding = "held",
        late_lost: bool = False,
        give: float = 0.0,
        objects: tuple[str, ...] = ("ball",),
        trials: int = 10,
    ) -> Ablation:
        method = Method("psd", "none")

        def results(ending: LiftEnding, *, lost: bool) -> Results[LiftOutcome]:
            outcome = LiftOutcome(ending, 3.0, 20.0, 1.5, 1.75, 0, firm, lost, give)
            outcomes = {(method, name): [outcome] * trials for name in objects}
            return Results(Trials(trials, 7, objects), (method,), Conditions(), outcomes)

        now, then = results(ending, lost=lost), results(late, lost=late_lost)
        budget = Budget(0.024, 0.02, 0.6, 0.45, 0.46, 0.1, 0.1)
        budgets = {name: [budget] * trials for name in objects}
        return Ablation({0: now, 100: then}, {"50 Hz": now}, {"lift x2": then}, budgets)

    return make


def _results(good: Result, bad: Result) -> Results[Result]:
    """Two trials with a ball and a box: our rule fails once, with the ball, the other rule always."""
    ours, none = Method("psd"), Method("psd", "none")
    outcomes = {
        (ours, "ball"): [good, bad],
        (ours, "box"): [good, good],
        (none, "ball"): [bad, bad],
        (none, "box"): [bad, bad],
    }
    return Results(Trials(2, 7, ("ball", "box")), (ours, none), Conditions(), outcomes)


@pytest.fixture
def lifts() -> Results[LiftOutcome]:
    """Results of a lift."""
    nan = float("nan")
    return _results(
        LiftOutcome("held", 3.0, 20.0, 1.5, 1.75, 0), LiftOutcome("missed", 30.0, nan, nan, 0.5, 1)
    )


@pytest.fixture
def taps() -> Results[TapOutcome]:
    """Results of a tap."""
    return _results(
        TapOutcome("registered", "top", 2.0, 30.0, 1, 0, 0, 0),
        TapOutcome("too late", "side", 4.0, 300.0, 3, 1, 1, 0),
    )
