from collections.abc import Callable

from flows.lab.experiments.experiment import Found, Kind
from flows.lab.experiments.trial_measures import numbers


def test_false_slips_are_told_as_shares_of_trials(found: Callable[[Kind], Found]) -> None:
    told = numbers(found("tap"), "psd, ours")
    assert (told["false_lift"], told["false_tap"]) == (25.0, 25.0)
