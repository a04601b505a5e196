from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.leaks.leak import (
    SEEN,
    card_leaks,
    constant_leaks,
    overlapping,
    seen_recordings,
    split_leaks,
)
from operators import s
from operators.errors import InputError


def recording(
    seed: int, split: str, *, group: str = "", span: tuple[int, int] | None = None, rows: int = 400
) -> LabelledRecording:
    counts = np.random.default_rng(seed).integers(-3, 4, (rows, 6)).cumsum(axis=0).astype(np.int16)
    label = np.repeat([0, 1], rows // 2).astype(np.int8)
    name = f"{split}-{seed}"
    return LabelledRecording(counts, label, "plane", name=name, split=split, group=group, span=span)


def piece(whole: LabelledRecording, rows: slice, split: str) -> LabelledRecording:
    return replace(
        whole, counts=whole.counts[rows], label=whole.label[rows], name=f"piece-{split}", split=split
    )


def card(*recordings: LabelledRecording) -> dict[str, Any]:
    return {SEEN: seen_recordings(recordings)}


def test_clean_splits_have_no_leak() -> None:
    clean = [
        recording(0, "train", group="steel", span=(0, 4 * s)),
        recording(1, "validation", group="steel", span=(60 * s, 64 * s)),
        recording(2, "test", group="wood", span=(0, 4 * s)),
    ]
    assert split_leaks([clean]) == []
    assert overlapping(clean, clean[2:]) == {2}
    assert card_leaks("net", card(*clean), clean[2:]) == []


def test_a_copy_in_two_splits_is_named() -> None:
    whole = recording(0, "train")
    [leak] = split_leaks([[whole, replace(whole, name="copy", split="test")]])
    assert (leak.kind, leak.method) == ("shared rows", "")
    assert "train-0 (train) and copy (test), 400 rows" in leak.finding


def test_a_copy_in_another_dataset_is_named() -> None:
    whole = recording(0, "train")
    assert len(split_leaks([[whole], [replace(whole, split="test")]])) == 1


def test_overlapping_pieces_of_a_recording_are_named_and_not_fitted_to() -> None:
    whole = recording(0, "")
    first, second = piece(whole, slice(250), "train"), piece(whole, slice(200, None), "test")
    other = recording(1, "train")
    [leak] = split_leaks([[first, other, second]])
    assert "piece-train (train) and piece-test (test), 50 rows" in leak.finding
    assert overlapping([first, other, second], [second]) == {0, 2}


def test_pieces_that_continue_each_other_are_named() -> None:
    pieces = [recording(0, "train", span=(0, 10 * s)), recording(1, "test", span=(10 * s, 20 * s))]
    [leak] = split_leaks([pieces])
    assert leak.kind == "neighbours"
    assert "train-0 (train) and test-1 (test)" in leak.finding
    assert split_leaks([[each] for each in pieces]) == []  # traces of two datasets both start at 0
    apart = [pieces[0], replace(pieces[1], span=(12 * s, 20 * s))]
    assert split_leaks([apart]) == []


def test_a_surface_in_training_and_test_is_named() -> None:
    [leak] = split_leaks([[recording(0, "train", group="steel"), recording(1, "test", group="steel")]])
    assert leak.kind == "known group"
    assert "test split's steel" in leak.finding


def test_a_model_judged_on_its_training_data_is_named() -> None:
    seen = recording(0, "train"), recording(1, "validation"), recording(2, "test")
    [trained] = card_leaks("net", card(*seen), [piece(seen[0], slice(399), "")])
    assert (trained.kind, trained.method) == ("trained on", "net")
    assert "piece- (train-0 in training)" in trained.finding
    [chosen] = card_leaks("net", card(*seen), [seen[1]])
    assert chosen.kind == "chosen on"
    assert card_leaks("net", card(*seen), [seen[2], recording(3, "train")]) == []


def test_a_model_judged_on_a_known_surface_is_named() -> None:
    seen = card(recording(0, "train", group="steel"))
    [leak] = card_leaks(
        "net", seen, [recording(5, "test", group="steel"), recording(6, "test", group="wood")]
    )
    assert leak.kind == "known group"
    assert leak.finding.endswith("judged steel")


def test_a_card_without_recordings_is_compared_by_its_dataset() -> None:
    old = {"data": [{"dataset": "paper-0", "sha256": "ab"}]}
    judged = [recording(0, "train"), recording(1, "test")]
    assert [leak.kind for leak in card_leaks("net", old, judged, "ab")] == ["trained on"]
    assert card_leaks("net", old, judged[1:], "ab") == []
    assert card_leaks("net", old, judged, "cd") == []
    assert card_leaks("net", {}, judged) == []


def test_a_damaged_card_is_refused() -> None:
    with pytest.raises(InputError, match="card of net: has an invalid list of hashes"):
        card_leaks("net", {SEEN: {"train": {"recordings": [["a", "?"]]}}}, [recording(0, "test")])


def test_a_constant_answer_is_named() -> None:
    [leak] = constant_leaks("psd", np.array([[840.0, 0.0], [160.0, 0.0]]))
    assert leak.kind == "constant answer"
    assert leak.finding == "psd answers static for every sample: its accuracy is the share of static, 84.0 %"
    [leak] = constant_leaks("psd", np.array([[0.0, 839.0], [2.0, 159.0]]))
    assert "answers slip for 99.8 % of the samples" in leak.finding
    assert constant_leaks("psd", np.array([[830.0, 10.0], [160.0, 0.0]])) == []
