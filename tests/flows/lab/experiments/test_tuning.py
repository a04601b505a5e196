from collections.abc import Callable

import numpy as np

from connectors.sim.objects import OBJECTS
from flows.lab.experiments.rivals import StepThreshold
from flows.lab.experiments.tap_trial import BLOWS
from flows.lab.experiments.trial import FINGERTIP, Trace
from flows.lab.experiments.tuning import THRESHOLDS, best_threshold, validation_trial
from operators.batch import Reals

_TIMES = np.arange(700) / 100  # s


def test_validation_trials_have_objects_and_fingertips_of_their_own() -> None:
    trials = [validation_trial(seed) for seed in range(800_000, 800_010)]
    assert validation_trial(800_000) == trials[0]
    known = {(each.mass, each.friction) for each in OBJECTS.values()}
    assert not {(trial.held.mass, trial.held.friction) for trial in trials} & known
    assert len({trial.held.mass for trial in trials}) == len(trials)
    assert all(trial.fingertip.tilt_stiffness != FINGERTIP.tilt_stiffness for trial in trials)


def test_a_tuned_threshold_is_the_middle_one_of_the_best(
    make_trace: Callable[..., Trace], during: Callable[..., Reals]
) -> None:
    _, *blows = BLOWS
    counts = np.zeros((700, 6), np.int16)
    counts[:, 2] = np.where(_TIMES % 0.04 < 0.02, during((2.0, 2.2), value=6), 0)  # a firm lift is loaded
    for blow in blows:
        counts[:, 2] += np.where(_TIMES % 0.04 < 0.02, during((blow, blow + 0.1), value=48), 0).astype(
            np.int16
        )
    slides = during(*((blow, blow + 0.05) for blow in blows), value=0.04)
    tuned = best_threshold(StepThreshold(), [make_trace(counts=counts, speed=slides)])
    good = THRESHOLDS[(THRESHOLDS > 6 / 14) & (THRESHOLDS <= 48 / 56)]
    assert tuned == good[len(good) // 2]
