import numpy as np
import pytest

from connectors.sim.objects import OBJECTS
from flows.lab.experiments.grasp_recordings import CREEP, draw_object, grasp_recordings, sliding_labels
from flows.learn.labelled_recordings import WARM_UP, LabelledRecording
from operators.batch import SLIP, STATIC, UNKNOWN, ms

COUNT = 20


@pytest.fixture(scope="module")
def recordings() -> list[LabelledRecording]:
    return list(grasp_recordings(COUNT, 4))


def test_a_seed_gives_the_same_recordings_and_another_seed_others(
    recordings: list[LabelledRecording],
) -> None:
    again, other = (next(grasp_recordings(1, seed)) for seed in (4, 5))
    assert (recordings[0].counts == again.counts).all()
    assert not np.array_equal(recordings[0].counts[:100], other.counts[:100])


def test_eight_of_ten_train_one_validates_and_one_tests(recordings: list[LabelledRecording]) -> None:
    splits = [recording.split for recording in recordings]
    assert {split: splits.count(split) for split in splits} == {"train": 16, "validation": 2, "test": 2}


def test_labels_are_true_sliding_and_both_occur(recordings: list[LabelledRecording]) -> None:
    for recording in recordings:
        assert recording.sliding is not None
        assert (recording.label[recording.sliding == SLIP] == SLIP).all()
        assert (recording.label[:WARM_UP] != SLIP).all()  # the gripper is open
    label = np.concatenate([recording.label for recording in recordings])
    assert 0.02 < (label == SLIP).mean() < 0.3
    assert (label == UNKNOWN).mean() < 0.05
    assert 0 < CREEP < 1


def test_short_sticks_are_slip_and_long_ones_are_not() -> None:
    sliding = np.zeros(40, np.bool_)
    sliding[[10, 13, 14, 25]] = True
    assert np.flatnonzero(sliding_labels(sliding, 50 * ms) == SLIP).tolist() == [10, 11, 12, 13, 14, 25]
    assert (sliding_labels(np.zeros(9, np.bool_)) == STATIC).all()


def test_objects_have_wider_ranges_than_the_six() -> None:
    random = np.random.default_rng(5)
    drawn = [draw_object(random) for _ in range(300)]
    assert {each.curvature for each in drawn} >= {each.curvature for each in OBJECTS.values()}
    for name in ("mass", "friction", "texture", "stiffness"):
        values = [getattr(each, name) for each in drawn]
        known = [getattr(each, name) for each in OBJECTS.values()]
        assert min(values) < min(known)
        assert max(values) > max(known)
    assert not {(each.mass, each.radius) for each in drawn} & {
        (each.mass, each.radius) for each in OBJECTS.values()
    }
