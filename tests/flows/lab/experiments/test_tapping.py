from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import pytest

from connectors.sim.objects import OBJECTS, named
from flows.lab.experiments import tapping
from flows.lab.experiments.tapping import BLOW, FAR, REALLY, Nothing, Tapping, tap
from flows.lab.experiments.trial import Trace
from flows.lab.experiments.trial_setting import Conditions
from operators import Grip
from operators.batch import Reals

Make: TypeAlias = Callable[..., Trace]
During: TypeAlias = Callable[..., Reals]

GRIP = Grip(settle=0)


def _judged(made: Make, trace: Trace, soft: Trace | None = None) -> Tapping:
    return tapping.judged(trace, soft or made(), GRIP, "top", 1)


def _blow(made: Make, during: During, *felt: tuple[float, float]) -> Trace:
    sliding = during((BLOW, BLOW + 0.05), value=0.04)
    return made(speed=sliding, slide=np.cumsum(sliding) / 100, probability=during(*felt))


def test_a_blow_that_is_registered_and_over_when_the_object_rests_is_felt(made: Make, during: During) -> None:
    outcome = _judged(made, _blow(made, during, (BLOW + 0.02, BLOW + 0.2)))
    assert outcome.success
    assert outcome.delay == pytest.approx(30)
    assert outcome.slide == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("felt", "ending"),
    [
        ((), "missed"),
        (((BLOW + 0.25, BLOW + 0.3),), "too late"),
        (((BLOW - 0.5, BLOW - 0.4), (BLOW, BLOW + 0.1)), "false before"),
        (((BLOW, BLOW + 0.6),), "not back to static"),
        (((BLOW, BLOW + 0.1), (BLOW + 1, BLOW + 1.1)), "not back to static"),
    ],
)
def test_each_failure_has_its_name(
    made: Make, during: During, felt: tuple[tuple[float, float], ...], ending: str
) -> None:
    assert _judged(made, _blow(made, during, *felt)).ending == ending


def test_what_is_knocked_out_of_the_hand_is_dropped(made: Make, during: During) -> None:
    trace = replace(_blow(made, during, (BLOW, BLOW + 0.1)), dropped=during((5.0, 7.0)) > 0)
    assert _judged(made, trace).ending == "dropped"


def test_what_is_registered_where_nothing_slips_is_counted_by_when(made: Make, during: During) -> None:
    soft = made(probability=during((2.1, 2.2), (4.0, 4.1), (BLOW, BLOW + 0.1)))
    outcome = _judged(made, made(), soft)
    assert (outcome.false_lift, outcome.false_hold, outcome.false_tap) == (1, 1, 1)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", OBJECTS)
def test_every_object_is_hit_so_that_it_really_slips_but_not_far(name: str, seed: int) -> None:
    _, outcome = tap(named(name), seed, (Nothing(), Grip()), Conditions())
    assert outcome.ending == "missed"
    assert REALLY <= outcome.slide <= FAR
    assert outcome.place == ("top" if seed else "side")
