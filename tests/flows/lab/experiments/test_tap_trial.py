import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from connectors.sim.objects import OBJECTS
from flows.lab.experiments.study import StepThreshold
from flows.lab.experiments.tap_and_lift import BLOWS, SIZES, TAP_END, judge_tap, tap
from flows.lab.experiments.trial import MOVED, STILL, Conditions, Trace, Trial
from operators import Grip
from tests.flows.lab.experiments.traces import during, make_trace

NEVER = StepThreshold(math.inf)  # never reports slip
RULE = Grip(settle=0)
SOFT, FIRST, SECOND = BLOWS


def simulated(trial: Trial) -> Trace:
    [(trace, _)] = tap(trial, [(NEVER, RULE)])
    return trace


SLIDES = [(FIRST, FIRST + 0.05), (SECOND, SECOND + 0.05)]


def hit(*slip: tuple[float, float], slides: Sequence[tuple[float, float]] = SLIDES) -> Trace:
    """A trace with two slides of 2 mm and slip decisions in the given spans (s)."""
    return make_trace(speed=during(*slides, value=0.04), probability=during(*slip))


GOOD = ((FIRST + 0.02, FIRST + 0.2), (SECOND + 0.02, SECOND + 0.2))


def test_two_registered_blows_and_nothing_else_are_a_success() -> None:
    outcome = judge_tap(hit(*GOOD), RULE)
    assert (outcome.ending, outcome.success) == ("registered", True)
    counted = {"false_firm": 0, "paper": 1, "moved": 2, "soft": 1, "lead": -30, "slide": 2}
    assert {name: outcome.metrics[name] for name in counted} == pytest.approx(counted)


@pytest.mark.parametrize(
    ("slip", "ending", "paper"),
    [
        ((), "missed", False),
        (GOOD[:1], "missed", False),
        ((GOOD[0], (SECOND + 0.25, SECOND + 0.3)), "too late", True),
        (((2.0, 2.1), *GOOD), "false slip", True),
        (((SOFT, SOFT + 0.1), *GOOD), "false at soft blow", True),
        (((FIRST, FIRST + 0.6), GOOD[1]), "not back to static", False),
        ((*GOOD, (SECOND + 0.8, SECOND + 0.9)), "not back to static", False),
    ],
)
def test_each_failure_has_its_ending_and_the_papers_definition_forgives_false_slips(
    slip: tuple[tuple[float, float], ...], ending: str, *, paper: bool
) -> None:
    outcome = judge_tap(hit(*slip), RULE)
    assert (outcome.ending, outcome.metrics["paper"]) == (ending, paper)


def test_missed_blows_are_counted_by_the_size_of_their_slide() -> None:
    metrics = judge_tap(hit(GOOD[1], slides=[(FIRST, FIRST + 0.02), (SECOND, SECOND + 0.08)]), RULE).metrics
    found = {size: (metrics[f"blows {size}"], metrics[f"missed {size}"]) for size in SIZES}
    assert found == {"0.5 to 1 mm": (1, 1), "1 to 2 mm": (0, 0), "above 2 mm": (1, 0)}


def test_a_blow_that_moves_nothing_must_not_be_registered() -> None:
    one = [(FIRST, FIRST + 0.05)]
    assert judge_tap(hit(GOOD[0], slides=one), RULE).success
    outcome = judge_tap(hit(*GOOD, slides=one), RULE)
    assert (outcome.ending, outcome.metrics["soft"], outcome.metrics["false_soft"]) == (
        "false at soft blow",
        2,
        1,
    )


def test_a_slide_between_still_and_moved_may_be_registered_or_not() -> None:
    little = [(FIRST, FIRST + 0.05), (SECOND, SECOND + 0.01)]  # 2 and 0.4 mm
    assert judge_tap(hit(*GOOD, slides=little), RULE).success
    assert judge_tap(hit(GOOD[0], slides=little), RULE).success


def test_a_slip_of_the_passive_fingers_alone_may_be_registered_or_not() -> None:
    trace = replace(hit(*GOOD, slides=[]), fastest=during((FIRST, FIRST + 0.05), value=0.04))
    assert judge_tap(trace, RULE).ending == "false at soft blow"  # the second
    first = replace(trace, probability=during(GOOD[0]))
    assert judge_tap(first, RULE).success
    assert judge_tap(replace(first, probability=during()), RULE).success


def test_an_object_knocked_out_of_the_gripper_is_dropped() -> None:
    trace = replace(hit(*GOOD), dropped=during((5.5, TAP_END)) > 0)
    assert judge_tap(trace, RULE).ending == "dropped"


@pytest.mark.parametrize(("seed", "name"), list(enumerate(OBJECTS)))
def test_a_firm_lift_and_a_soft_blow_move_nothing_and_other_blows_do_but_drop_nothing(
    name: str, seed: int
) -> None:
    trace = simulated(Trial.draw(name, seed, Conditions()))
    soft, *moved = (
        trace.travel(trace.between(*span)) for span in ((SOFT, FIRST), (FIRST, SECOND), (SECOND, TAP_END))
    )
    assert trace.travel(trace.between(1.5, SOFT)) < MOVED / 2
    assert soft < 2 * STILL
    assert max(moved) > STILL
    assert not trace.dropped[-1]


def test_methods_share_one_simulation_and_draws_depend_on_the_seed_only() -> None:
    trial = Trial.draw("ball", 3, Conditions())
    (first, outcome), (second, _) = tap(trial, [(NEVER, Grip()), (NEVER, RULE)])
    assert first.counts is second.counts
    assert (first.counts == simulated(trial).counts).all()
    assert outcome.ending == "missed"
    assert np.isnan(outcome.metrics["lead"])
