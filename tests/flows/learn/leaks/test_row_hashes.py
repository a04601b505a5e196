import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.leaks.row_hashes import SPAN, listed_hashes, occur, parse_hashes, row_hashes, shared_rows
from operators.batch import Counts
from operators.errors import InputError


def moving(seed: int, rows: int = 600, cells: int = 6) -> Counts:
    return np.random.default_rng(seed).integers(-3, 4, (rows, cells)).cumsum(axis=0).astype(np.int16)


def recording(counts: Counts, name: str = "") -> LabelledRecording:
    return LabelledRecording(counts, np.zeros(len(counts), np.int8), "plane", name=name)


@given(
    st.integers(0, 99),
    st.integers(1, 16),
    st.integers(SPAN + 1, 300),
    st.integers(0, 300),
    st.integers(-99, 99),
)
@settings(max_examples=30, deadline=None)
def test_a_piece_is_found_at_any_place_and_with_any_baseline(
    seed: int, cells: int, rows: int, begin: int, baseline: int
) -> None:
    whole = moving(seed, cells=cells)
    piece, before = whole[begin : begin + rows] + baseline, moving(seed + 100, 50, cells)
    before += piece[0] - before[-1] + 50  # the joint does not continue the piece by chance
    other = np.concatenate([before, piece])
    found = shared_rows([recording(whole), recording(other.astype(np.int16))], ["train", "test"])
    spans = row_hashes(recording(whole[begin : begin + rows]))  # of one or two cells, some hardly change
    assert [each.rows - SPAN for each in found] == ([len(spans)] if len(spans) else [])
    if cells > 1:
        assert found[0].rows == rows


@given(st.integers(0, 99), st.integers(1, 16))
@settings(max_examples=30, deadline=None)
def test_unrelated_recordings_share_nothing(seed: int, cells: int) -> None:
    pair = [recording(moving(seed, cells=cells)), recording(moving(seed + 100, cells=cells))]
    assert shared_rows(pair, [0, 1]) == []


def test_stretches_in_which_hardly_anything_changes_are_not_shared() -> None:
    quiet = np.zeros((500, 6), np.int16)
    quiet[::40, 2] = 1
    pair = [recording(np.concatenate([quiet, moving(seed)])) for seed in (1, 2)]
    assert shared_rows(pair, [0, 1]) == []


def test_recordings_of_the_same_part_are_not_compared() -> None:
    same = [recording(moving(1)), recording(moving(1))]
    assert shared_rows(same, ["train", "train"]) == []
    assert len(shared_rows(same, ["train", "test"])) == 1


@pytest.mark.parametrize("rows", [0, 1, SPAN, SPAN + 1])
def test_a_recording_may_be_short(rows: int) -> None:
    assert len(row_hashes(recording(moving(0, rows)))) == max(rows - SPAN, 0)


def test_a_card_finds_its_recording_again_and_the_larger_part_of_it() -> None:
    whole = moving(3, 2000)
    listed = parse_hashes(listed_hashes(recording(whole)), "card")
    assert occur(listed, recording(whole)).all()
    assert occur(listed, recording(whole[400:])).any()
    assert not occur(listed, recording(moving(4, 2000))).any()


def test_listed_hashes_stay_the_same_as_cards_keep_them() -> None:
    assert listed_hashes(recording(moving(0, 34))) == "YyeeJhM46DjkUcTq"


def test_damaged_hashes_are_refused() -> None:
    for text in ("AAA", "AAAAAAAA!", None, 3):
        with pytest.raises(InputError, match=r"m\.json: has an invalid list of hashes"):
            parse_hashes(text, "m.json")
