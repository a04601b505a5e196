import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from operators import SLIP, STATIC, UNKNOWN, Label, Labelled, Sample, concat, ms
from operators.batch import Reals, Times


def _sample(velocity: ArrayLike, pose: ArrayLike = np.nan, time: Times | None = None) -> Sample:
    velocity = np.array(velocity, np.float64)
    rows = len(velocity)
    time = np.arange(rows) * 10 * ms if time is None else time
    return Sample.rows(time, 0, 0, True, velocity, pose, ~np.isnan(velocity[:, 0]), finger=4)


def _along_x(*speed: float) -> Reals:
    velocity = np.zeros((len(speed), 6))
    velocity[:, 0] = speed
    return velocity


def _label(label: Label, sample: Sample) -> Labelled:
    return concat(Labelled, [label.push(sample), label.flush()])


def test_slip_is_above_the_threshold_and_unknown_from_the_limit_on() -> None:
    labelled = _label(Label(), _sample(_along_x(0, 0.003, 0.0031, 0.2999, 0.3, np.nan, np.inf)))
    assert labelled.label.tolist() == [STATIC, STATIC, SLIP, SLIP, UNKNOWN, UNKNOWN, UNKNOWN]
    assert labelled.speed[:4].tolist() == [0, 0.003, 0.0031, 0.2999]
    assert np.isnan(labelled.speed[5])
    assert labelled.finger == 4


@given(seed=st.integers(0, 2**32 - 1))
def test_the_speed_equals_that_with_scipys_rotation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    velocity, pose = rng.normal(size=(9, 6)), rng.normal(size=(9, 6))
    turned = Rotation.from_rotvec(pose[:, 3:]).inv().apply(velocity[:, :3])
    speed = _label(Label(), _sample(velocity, pose)).speed
    np.testing.assert_allclose(speed, np.linalg.norm(turned[:, :2], axis=1), atol=1e-13)


def test_without_a_pose_the_velocity_is_taken_as_it_is() -> None:
    pose = [[0, 0, 0, np.nan, 0, 0], [np.nan, np.nan, np.nan, 0, 0, 0], [0, 0, 0, 0, np.inf, 0]]
    rows = _label(Label(), _sample(np.tile([0.03, 0.04, 0.2, 0, 0, 0], (3, 1)), pose))
    assert rows.speed.tolist() == pytest.approx([0.05] * 3)


def test_rotation_is_slip_above_its_threshold() -> None:
    turning = np.array([[0.0, 0, 0, 0.12, 0.16, 0.01]])
    assert (_label(Label(rotation=np.inf), _sample(turning)).label == STATIC).all()
    assert (_label(Label(), _sample(turning)).label == SLIP).all()
    assert (_label(Label(rotation=0.21), _sample(turning)).label == STATIC).all()
    turning[:, 0] = 0.3
    assert (_label(Label(), _sample(turning)).label == UNKNOWN).all()
    turning[:, 0], turning[:, 4] = 0.1, np.nan
    assert (_label(Label(), _sample(turning)).label == UNKNOWN).all()
    assert (_label(Label(rotation=np.inf), _sample(turning)).label == SLIP).all()


steps = st.lists(st.sampled_from([0, 1, 5, 10, 10, 10, 35]), min_size=1, max_size=50)


def _expected(time: Times, speed: Reals, delay: int, within: int) -> Reals:
    """Row by row: the speed of the last row up to each shifted instant."""
    result = np.full(len(time), np.nan)
    for row, instant in enumerate((time + delay).tolist()):
        candidates = [i for i in range(len(time)) if instant - within <= time[i] <= instant]
        if candidates:
            result[row] = speed[candidates[-1]]
    return result


@given(steps=steps, delay=st.integers(-60, 60).filter(bool))
def test_a_delay_takes_speed_and_label_from_the_last_row_up_to_then(steps: list[int], delay: int) -> None:
    time = np.cumsum(steps) * ms
    sample = _sample(_along_x(*np.arange(1, len(steps) + 1) / 250), time=time)
    labelled = _label(Label(delay=delay * ms), sample)
    expected = _expected(time, sample.velocity[:, 0], delay * ms, 20 * ms)
    np.testing.assert_array_equal(labelled.time, time)
    np.testing.assert_array_equal(labelled.velocity, sample.velocity)
    np.testing.assert_array_equal(labelled.speed, expected)
    slip = np.where(expected > 0.003, SLIP, STATIC)
    np.testing.assert_array_equal(labelled.label, np.where(expected < 0.3, slip, UNKNOWN))


def test_a_delay_holds_samples_until_their_motion_has_arrived() -> None:
    label = Label(delay=20 * ms)
    sample = _sample(_along_x(0, 0.1, 0.2, 0.25))
    assert len(label.push(sample[:3])) == 0
    assert label.push(sample[3:]).speed.tolist() == [0.2]
