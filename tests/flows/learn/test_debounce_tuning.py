import numpy as np

from flows.learn.debounce_tuning import tuned
from flows.learn.event_metrics import EventMetrics, Slips
from flows.learn.labelled_recordings import LabelledRecording
from operators import Debounce
from operators.batch import Reals


def recordings(seed: int, number: int = 4, noise: float = 1.0) -> tuple[list[Reals], list[Slips]]:
    """Slips, and probabilities that follow them 20 ms late, with errors that last some samples."""
    random = np.random.default_rng(seed)
    found, slips = list[Reals](), list[Slips]()
    for _ in range(number):
        label = np.repeat(random.integers(0, 2, 40), random.integers(20, 60, 40)).astype(np.int8)
        wander = np.repeat(random.normal(size=len(label) // 3 + 1), 3)[: len(label)]
        logit = np.roll(label, 2) * 6 - 3 + noise * 2 * wander
        probability = 1 / (1 + np.exp(-logit))
        probability[random.random(len(label)) < 0.01] = np.nan
        found.append(probability)
        slips.append(Slips.labelled(LabelledRecording(np.zeros((len(label), 6), np.int16), label)))
    return found, slips


def test_a_larger_budget_is_kept_with_a_margin_for_chance_and_spent_on_less_delay() -> None:
    found, slips = recordings(2, number=6)
    delays = list[float]()
    for budget in (4.0, 20.0, 80.0):
        events = EventMetrics.of(found, slips, tuned(found, slips, budget))
        assert events.false_alarms + 1 + np.sqrt(events.false_alarms + 0.75) <= budget * events.minutes
        delays.append(events.delays.mean())
    assert delays[0] > delays[1] > delays[2]


def test_missed_and_repeated_slips_are_kept_within_their_limits_where_that_can_be() -> None:
    found, slips = recordings(3, noise=0.3)
    events = EventMetrics.of(found, slips, tuned(found, slips))
    assert events.false_alarms < 2 * events.minutes
    assert events.missed <= 2
    assert events.repeated <= 2


def test_where_no_setting_keeps_the_budget_the_fewest_false_alarms_win() -> None:
    found, slips = recordings(4, noise=2.0)
    chosen = tuned(found, slips, budget=0.0)
    fewest = EventMetrics.of(found, slips, chosen).false_alarms
    for other in (Debounce(), Debounce(0.9, 3, 3), Debounce(0.95, 5, 12)):
        assert fewest <= EventMetrics.of(found, slips, other).false_alarms
