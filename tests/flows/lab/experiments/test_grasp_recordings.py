import numpy as np
import pytest

from connectors.sim.objects import OBJECTS
from flows.lab.experiments.grasp_recordings import (
    draw_fingertip,
    draw_object,
    grasp_recordings,
    sliding_labels,
)
from flows.lab.experiments.trial import FINGERTIP
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.sampling import WARM_UP
from operators.batch import SLIP, STATIC, UNKNOWN, ms

COUNT = 20


@pytest.fixture(scope="module")
def recordings() -> list[LabelledRecording]:
    return grasp_recordings(COUNT, 4, jobs=1)


def test_a_seed_gives_the_same_recordings_and_another_seed_others(
    recordings: list[LabelledRecording],
) -> None:
    [again], [other] = (grasp_recordings(1, seed, jobs=1) for seed in (4, 5))
    assert (recordings[0].counts == again.counts).all()
    assert not np.array_equal(recordings[0].counts[:100], other.counts[:100])


def test_eight_of_ten_train_one_validates_and_one_tests(recordings: list[LabelledRecording]) -> None:
    splits = [recording.split for recording in recordings]
    assert {split: splits.count(split) for split in splits} == {"train": 16, "validation": 2, "test": 2}


def test_labels_are_true_sliding_and_both_occur(recordings: list[LabelledRecording]) -> None:
    for recording in recordings:
        assert recording.sliding is not None
        assert (recording.label == recording.sliding).all()
        assert (recording.label[:WARM_UP] == STATIC).all()  # the gripper is open
    label = np.concatenate([recording.label for recording in recordings])
    assert 0.02 < (label == SLIP).mean() < 0.3
    assert (label == UNKNOWN).mean() < 0.05


def test_firm_and_weak_grasps_are_among_them(recordings: list[LabelledRecording]) -> None:
    slips = [bool((recording.label == SLIP).any()) for recording in recordings]
    assert 0.2 < np.mean(slips) < 0.9


def test_short_sticks_are_slip_and_long_ones_are_not() -> None:
    speed = np.zeros(40)
    speed[[10, 13, 14, 25]] = 0.06  # m/s: 0.6 mm each
    assert np.flatnonzero(sliding_labels(speed, 50 * ms) == SLIP).tolist() == [10, 11, 12, 13, 14, 25]
    assert (sliding_labels(np.zeros(9)) == STATIC).all()


def test_a_slide_that_moves_nothing_is_static_and_a_little_one_unknown() -> None:
    assert sliding_labels(np.array([0.0, 0.004, 0.004, 0.0])).tolist() == [STATIC] * 4  # 0.08 mm
    assert sliding_labels(np.array([0.0, 0.02, 0.02, 0.0])).tolist() == [STATIC, UNKNOWN, UNKNOWN, STATIC]


def test_no_grasp_has_the_fingertip_of_the_experiments() -> None:
    random = np.random.default_rng(3)
    for fingertip in (draw_fingertip(random) for _ in range(50)):
        for name in ("tilt_stiffness", "stiffness", "lever", "static_friction", "sensitivity", "noise"):
            assert getattr(fingertip, name) != getattr(FINGERTIP, name)


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
