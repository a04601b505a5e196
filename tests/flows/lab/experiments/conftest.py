"""Traces and findings that are made up, to be judged."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flows.lab.experiments.experiment import Found, Kind, Method
from flows.lab.experiments.lift_ablation import Ablation
from flows.lab.experiments.lifting import Ending, Lifting
from flows.lab.experiments.slide_budget import Budget
from flows.lab.experiments.tapping import Tapping
from flows.lab.experiments.trial import Trace
from flows.lab.experiments.trial_setting import Conditions
from operators.batch import Reals

_T = np.arange(600) / 100  # s


@pytest.fixture
def made() -> Callable[..., Trace]:
    """A trace of 6 s in which nothing happens but what is said, column by column."""
    nothing, never = np.zeros(600), np.zeros(600, np.bool_)
    counts = np.zeros((600, 6), np.int16)
    calm = Trace(
        _T, counts, nothing, nothing + 1, nothing + 1, nothing, nothing, nothing, nothing, never, never
    )

    def trace(**changed: Any) -> Trace:  # noqa: ANN401 - columns of several types
        return replace(calm, **changed)

    return trace


@pytest.fixture
def during() -> Callable[..., Reals]:
    """A column that is `value` within spans (s), else 0."""

    def column(*spans: tuple[float, float], value: float = 1.0) -> Reals:
        inside = np.zeros(600, np.bool_)
        for since, until in spans:
            inside |= (since - 1e-9 <= _T) & (until - 1e-9 > _T)
        return np.where(inside, value, 0.0)

    return column


@pytest.fixture
def ablated() -> Callable[..., Ablation]:
    """An ablation of one method, by default with ten trials of a ball, made up; objects fare alike."""

    def made(
        *,
        firm: float,
        ending: Ending = "held",
        lost: bool = False,
        late: Ending = "held",
        late_lost: bool = False,
        give: float = 0.0,
        objects: tuple[str, ...] = ("ball",),
        trials: int = 10,
    ) -> Ablation:
        def found(how: Ending, *, gone: bool) -> Found:
            trial = Lifting(how, 3.0, 20.0, 1.5, 1.75, 0, firm, gone, give)
            outcomes = {("psd, none", thing): [trial] * trials for thing in objects}
            method = Method("psd", "none")
            return Found("lift", trials, 7, Conditions(), outcomes, (method.name,), objects, method)

        now, then = found(ending, gone=lost), found(late, gone=late_lost)
        left = Budget(0.024, 0.02, 0.6, 0.45, 0.46, 0.1, 0.1)
        return Ablation(
            ("psd, none",),
            {0: now, 100: then},
            {"50 Hz": now},
            {"lift x2": then},
            {thing: [left] * trials for thing in objects},
        )

    return made


@pytest.fixture
def found() -> Callable[[Kind], Found]:
    """Two trials with a ball and with a box: our rule fails once, with the ball, the other rule always."""

    def make(kind: Kind) -> Found:
        held = Lifting("held", 3.0, 20.0, 1.5, 1.75, 0)
        missed = Lifting("missed", 30.0, float("nan"), float("nan"), 0.5, 1)
        felt = Tapping("felt", "top", 2.0, 30.0, 1, 0, 0, 0)
        late = Tapping("too late", "side", 4.0, 300.0, 3, 1, 1, 0)
        good, bad = (held, missed) if kind == "lift" else (felt, late)
        outcomes = {
            ("psd, ours", "ball"): [good, bad],
            ("psd, ours", "box"): [good, good],
            ("psd, none", "ball"): [bad, bad],
            ("psd, none", "box"): [bad, bad],
        }
        return Found(
            kind,
            2,
            7,
            Conditions(),
            outcomes,
            ("psd, ours", "psd, none"),
            ("ball", "box"),
            Method("psd", "ours"),
        )

    return make
