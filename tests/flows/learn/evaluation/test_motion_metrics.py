import numpy as np
import pytest

from flows.learn.evaluation.motion_metrics import MotionConfusions, MotionKind
from flows.learn.labelled_recordings import LabelledRecording

SLIDE = MotionKind("primary", 0.05, "plane")
ACROSS = MotionKind("oblique", 0.05, "plane")
TURN = MotionKind("rotation", None, "sphere")


def recording(surface: str, speed: float | None, oblique: list[bool] | None) -> LabelledRecording:
    label = np.array([0, 1] * 5, np.int8)
    known = None if oblique is None else np.array(oblique)
    return LabelledRecording(np.zeros((10, 6), np.int16), label, surface, speed, known)


@pytest.fixture
def confusions() -> MotionConfusions:
    recordings = [
        recording("plane", 0.05, [False] * 6 + [True] * 4),
        recording("sphere", None, [False] * 10),
        recording("", None, None),
    ]
    at = [np.arange(2, 10)] * 3
    slip = [one.slip[2:] for one in recordings]
    return MotionConfusions.of(recordings, at, [slip[0], ~slip[1], slip[2]])


def test_predictions_are_counted_by_axis_speed_and_surface(confusions: MotionConfusions) -> None:
    assert confusions.at(SLIDE).counts.tolist() == [[2, 0], [0, 2]]
    assert confusions.at(ACROSS).f1 == 100
    assert confusions.at(TURN).accuracy == 0
    assert np.isnan(confusions.at(MotionKind("oblique", 0.1, "plane")).f1)


def test_a_recording_with_unknown_strokes_is_left_out(confusions: MotionConfusions) -> None:
    assert {kind.surface for kind in confusions.kinds} == {"plane", "sphere"}
    assert confusions.confusion().counts.sum() == 16
