import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import pytest

from flows.lab.experiments.experiment import Method
from flows.lab.experiments.lift_ablation import (
    HARD,
    HELD,
    RATES,
    Ablation,
    ablation,
    crossing,
    delayed,
    rates,
)
from flows.lab.experiments.trial_setting import Conditions

NONE = "psd, none"


def test_success_falls_below_a_level_between_two_places() -> None:
    assert crossing([0, 100, 200], [100, 95, 85]) == 150
    assert crossing([0, 100], [80, 100]) == 0
    assert crossing([0, 100], [100, 90]) == math.inf


def test_each_rate_differs_from_nominal_in_its_rate_only() -> None:
    nominal = Conditions()
    tried = rates(nominal)
    assert len(tried) == len(RATES) + len(HELD)
    assert tried["50 Hz"] == replace(nominal, rate=50.0)
    assert tried["50 Hz, held"] == replace(nominal, every=2)


def test_a_delay_is_added_to_what_there_is() -> None:
    late = delayed(delayed(Conditions(), 50), 100)
    assert late.hand.delay == pytest.approx(0.15)
    assert replace(late, hand=Conditions().hand) == Conditions()


def test_an_object_breaks_where_the_hand_has_climbed_its_room_before_it_grips_firmly(
    ablated: Callable[..., Ablation],
) -> None:
    of = ablated(firm=0.15)
    assert of.predicted(NONE, "ball") == pytest.approx(300, abs=1)  # 20 mm after 450 ms
    assert of.predicted(NONE, "ball", lost=True) == pytest.approx(380, abs=1)  # 24 mm after 530 ms


def test_what_fingers_and_rubber_give_is_way_that_an_object_cannot_slide(
    ablated: Callable[..., Ablation],
) -> None:
    of = ablated(firm=0.15, give=2.0)
    assert of.predicted(NONE, "ball") == pytest.approx(260, abs=1)  # 18 mm after 410 ms
    assert of.predicted(NONE, "ball", lost=True) == pytest.approx(380, abs=1)


def test_a_trial_that_fails_without_delay_has_nothing_to_spare_and_one_that_holds_all_along_everything(
    ablated: Callable[..., Ablation],
) -> None:
    failed = ablated(firm=0.15, ending="too late", lost=True)
    assert failed.predicted(NONE, "ball") == failed.predicted(NONE, "ball", lost=True) == 0
    assert ablated(firm=0.0).predicted(NONE, "ball") == math.inf
    assert ablated(firm=math.nan).predicted(NONE, "ball") == math.inf


def test_it_breaks_where_it_is_measured_to(ablated: Callable[..., Ablation]) -> None:
    of = ablated(firm=0.15, late="left behind")
    assert of.breaks(NONE, "ball") == pytest.approx(10)  # from 100 % to 0 within 100 ms
    assert of.loses(NONE, "ball") == math.inf
    assert ablated(firm=0.15, late="too late", late_lost=True).loses(NONE, "ball") == pytest.approx(10)
    assert of.first(NONE) == "ball"


def test_every_condition_is_tried_with_the_same_trials() -> None:
    seen: list[tuple[int, int, str]] = []
    of = ablation(
        [Method("psd", "none")],
        trials=1,
        objects=["ball"],
        delays=(0, 600),
        jobs=1,
        progress=lambda done, all_, part: seen.append((done, all_, part)),
    )
    groups: Sequence[Mapping[int, object] | Mapping[str, object]] = (of.delays, of.rates, of.hard)
    assert [len(each) for each in groups] == [2, len(RATES) + len(HELD), len(HARD)]
    assert {each.seed for each in (*of.delays.values(), *of.rates.values(), *of.hard.values())} == {900_000}
    assert seen[0][:2] == (0, sum(len(each) for each in groups))
    assert of.nominal.success(NONE, "ball") == 0
    assert of.lost(of.nominal, NONE, "ball") == 100
