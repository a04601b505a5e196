from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from connectors.sim.scene import Timing
from flows.lab.simulation import PLANS
from flows.learn.labelled_recordings import LabelledRecording, load, simulated_recordings
from flows.learn.training.label_lag import lags, relabelled


@pytest.fixture(scope="module")
def recordings(tiny: Path) -> list[LabelledRecording]:
    return load(tiny)


def _later(recording: LabelledRecording, samples: int) -> LabelledRecording:
    return replace(recording, label=np.roll(recording.label, samples))


def test_the_latency_of_the_arm_is_found_in_its_recordings() -> None:
    def of_arm(latency: float) -> list[LabelledRecording]:
        arm = Timing(125.0, latency=latency)
        return simulated_recordings(PLANS["tiny"], 0, lambda scene: replace(scene, motion=arm))

    assert lags(of_arm(0.13)) - lags(of_arm(0.03)) == pytest.approx(0.1, abs=0.005)


def test_labels_that_come_later_have_so_much_more_lag(recordings: list[LabelledRecording]) -> None:
    later = lags([_later(recording, 10) for recording in recordings])
    assert np.median(later - lags(recordings)) == pytest.approx(0.1, abs=0.005)


def test_relabelled_recordings_have_the_lag_asked_for(recordings: list[LabelledRecording]) -> None:
    found = lags(relabelled([_later(recording, 10) for recording in recordings], 0.04))
    assert np.median(np.abs(found - 0.04)) < 0.01


def test_a_recording_that_tells_nothing_has_the_lag_of_the_others(
    recordings: list[LabelledRecording],
) -> None:
    silent = replace(recordings[0], counts=np.zeros_like(recordings[0].counts))
    assert lags([*recordings[1:], silent])[-1] == np.median(lags(recordings[1:]))
    assert lags([silent]).tolist() == [0.0]


def test_a_recording_that_is_too_short_is_left_as_it_is() -> None:
    short = LabelledRecording(np.zeros((30, 6), np.int16), np.ones(30, np.int8), "plane")
    assert relabelled([short], 0.0)[0].label.tolist() == [1] * 30
