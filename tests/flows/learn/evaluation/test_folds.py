from dataclasses import replace

import numpy as np
import pytest

from flows.learn.evaluation.folds import group_folds, split_fold
from flows.learn.labelled_recordings import LabelledRecording
from operators.errors import InputError


def still(recording: LabelledRecording) -> LabelledRecording:
    return replace(recording, label=np.zeros_like(recording.label), name=f"still {recording.name}")


def test_each_group_is_held_out_once(surfaces: list[LabelledRecording]) -> None:
    folds = group_folds(surfaces, ["all"], "strokes")
    assert [fold.name for fold in folds] == ["steel", "wood", "wool"]
    assert [each.name for fold in folds for each in fold.judged] == [each.name for each in surfaces]
    for fold in folds:
        assert {each.group for each in fold.judged} == {fold.name}
        learned = [*fold.train, *fold.validation]
        assert len({each.name for each in learned}) == 6
        assert fold.name not in {each.group for each in learned}
    copy = replace(surfaces[0], group="wool", name="copy")
    [steel] = group_folds([*surfaces, copy], ["steel"], "strokes")
    assert copy not in [*steel.train, *steel.validation]


def test_every_fifth_recording_with_slip_and_without_validates(surfaces: list[LabelledRecording]) -> None:
    [fold] = group_folds([*surfaces, *map(still, surfaces)], ["wool"], "strokes")
    assert (len(fold.train), len(fold.validation)) == (10, 2)
    assert sum(each.slip.any() for each in fold.validation) == 1
    [few] = group_folds([*surfaces[:4], *map(still, surfaces)], ["wool"], "strokes")
    assert few.train == few.validation, "none with slip can be spared"


@pytest.mark.parametrize("group", ["", "steel"])
def test_fewer_than_two_groups_cannot_be_held_out(surfaces: list[LabelledRecording], group: str) -> None:
    with pytest.raises(InputError, match="strokes: states fewer than two groups"):
        group_folds([replace(each, group=group) for each in surfaces], ["all"], "strokes")


def test_an_unknown_group_or_a_missing_class_is_refused(surfaces: list[LabelledRecording]) -> None:
    with pytest.raises(InputError, match="has no recordings of glass; its groups: steel, wood, wool"):
        group_folds(surfaces, ["glass"], "strokes")
    with pytest.raises(InputError, match="has no slip"):
        group_folds([*map(still, surfaces)], ["all"], "strokes")
    with pytest.raises(InputError, match="has no slip in its test split; choose another"):
        split_fold([replace(still(surfaces[0]), split="test")], "test", "strokes")
    with pytest.raises(InputError, match="has no slip to judge detectors on"):
        split_fold([still(surfaces[0])], "all", "strokes")
    with pytest.raises(InputError, match="has no split 'test'; it has none"):
        split_fold(surfaces, "test", "strokes")
