"""Sessions on a regular grid of time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.batch import EVERY, Motion, Touch, ms
from operators.errors import InputError
from storage.exports.grid import Contents, find_contents, to_frames
from storage.hand_labels import LabelSpan
from tests.storage.made import new_batch, new_samples, record

MOVED = Contents((0,), 6, velocity=True, pose=False)


def poses(time: list[int]) -> Motion:
    known = np.arange(len(time))[:, None] + np.zeros(6)
    return Motion(np.array(time), np.array(time), np.zeros((len(time), 6)), known, finger=EVERY)


def test_regular_samples_become_one_frame_each(tmp_path: Path) -> None:
    samples = new_samples(np.arange(50) * 10 * ms + 7)
    cut = to_frames(record(tmp_path, [samples]), 100, MOVED)
    (found,) = cut.stretches
    assert cut.samples == 50
    assert found.time.tolist() == samples.time.tolist()
    assert found.counts.tolist() == samples.counts.tolist()
    assert found.label[:, 0].tolist() == samples.label.tolist()
    assert found.velocity.tolist() == samples.velocity.tolist()
    assert found.valid.all()


def test_labels_given_by_hand_replace_those_by_arm_speed(tmp_path: Path) -> None:
    session = record(tmp_path, [new_samples(np.arange(4) * 10 * ms)])
    session.write_hand_labels([LabelSpan(10 * ms, 30 * ms, 0, "static")], based_on=0)
    (found,) = to_frames(session, 100, MOVED).stretches
    assert found.label[:, 0].tolist() == [-1, 0, 0, -1]  # arm: -1, 0, 1, -1


@given(
    steps=st.lists(st.integers(0, 40 * ms), min_size=1, max_size=60),
    rate=st.sampled_from([1, 30, 50, 99, 100, 1000]),
)
def test_a_frame_is_a_sample_near_its_grid_point_and_no_sample_is_used_twice(
    tmp_path_factory: pytest.TempPathFactory, steps: list[int], rate: int
) -> None:
    samples = new_samples(np.cumsum(steps))
    cut = to_frames(record(tmp_path_factory.mktemp("any"), [samples]), rate, MOVED)
    used = list[int]()
    for stretch in cut.stretches:
        assert len(stretch) > 1
        place = [int(row) // 10 for row in stretch.counts[:, 0]]  # of the sample, from its counts
        assert stretch.time.tolist() == samples.time[place].tolist()
        used += place
        since = (stretch.time - samples.time[0]) * rate / 1e9  # periods
        ticks = np.floor(since + 0.5)
        assert np.abs(since - ticks).max() <= 0.5 + 1e-6
        assert (np.diff(ticks) == 1).all()
    assert len(set(used)) == len(used)


def test_a_gap_splits_and_the_nearer_of_two_samples_is_kept(tmp_path: Path) -> None:
    times = np.array([0, 10, 13, 18, 50, 60, 90]) * ms
    cut = to_frames(record(tmp_path, [new_samples(times)]), 100, MOVED)
    assert [each.time.tolist() for each in cut.stretches] == [
        [0, 10 * ms, 18 * ms],
        [50 * ms, 60 * ms],
    ]  # the last stands alone


def test_a_frame_needs_every_fingertip(tmp_path: Path) -> None:
    time = np.arange(10) * 10 * ms
    missing = new_samples(np.delete(time, 5) + 4 * ms, finger=2)
    session = record(tmp_path, [new_samples(time), missing])
    contents = find_contents(session)
    assert contents == Contents((0, 2), 6, velocity=True, pose=False)
    one, other = to_frames(session, 100, contents).stretches
    assert one.time.tolist() == time[:5].tolist()
    assert other.time.tolist() == time[6:].tolist()
    assert one.counts.shape == (5, 12)
    assert one.counts[1].tolist() == [10, 11, 12, 13, 14, 15, 2010, 2011, 2012, 2013, 2014, 2015]


def test_a_frame_needs_the_requested_motion_data(tmp_path: Path) -> None:
    samples = new_samples(np.arange(6) * 10 * ms)
    samples.velocity[2, 4] = np.nan
    session = record(tmp_path, [samples, poses([0, 8 * ms, 40 * ms])])
    assert find_contents(session) == Contents((0,), 6, velocity=True, pose=True)
    assert [len(each) for each in to_frames(session, 100, MOVED).stretches] == [2, 3]
    (still,) = to_frames(session, 100, Contents((0,), 6, velocity=False, pose=True)).stretches
    assert still.pose[:, 0].tolist() == [0, 1, 1, 2, 2, 2]  # of the nearest row; at a tie, the later
    assert np.isnan(still.velocity[2]).any()


def test_a_distant_pose_is_unknown(tmp_path: Path) -> None:
    session = record(tmp_path, [new_samples(np.arange(9) * 10 * ms), poses([20 * ms])])
    (found,) = to_frames(session, 100, Contents((0,), 6, velocity=True, pose=True)).stretches
    assert found.time.tolist() == [0, 10 * ms, 20 * ms, 30 * ms, 40 * ms]


def test_a_cell_without_a_reading_keeps_its_last_value_and_is_marked(tmp_path: Path) -> None:
    samples = new_samples(np.arange(3) * 10 * ms)
    valid = samples.valid.copy()
    valid[1, 3] = False
    session = record(tmp_path, [replace(samples, valid=valid)])
    (found,) = to_frames(session, 100, MOVED).stretches
    assert found.counts[:, 3].tolist() == [3, 3, 23]
    assert found.valid[:, 3].tolist() == [True, False, True]


def test_late_rows_are_sorted(tmp_path: Path) -> None:
    session = record(tmp_path, [new_samples(np.array([0, 20, 10, 30]) * ms)])
    (found,) = to_frames(session, 100, MOVED).stretches
    assert found.counts[:, 0].tolist() == [0, 20, 10, 30]


def test_a_session_without_samples_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no samples, which frames are made of"):
        find_contents(record(tmp_path, [new_batch(Touch)]))


def test_a_session_may_begin_before_its_clock_was_set(tmp_path: Path) -> None:
    times = np.array([0, 10, 20, 2_000_000_000_000, 2_000_000_000_010]) * ms
    cut = to_frames(record(tmp_path, [new_samples(times)]), 100, MOVED)
    assert [each.time.tolist() for each in cut.stretches] == [times[:3].tolist(), times[3:].tolist()]
