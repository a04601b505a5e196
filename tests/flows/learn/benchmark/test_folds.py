from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest

from flows.learn.benchmark.folds import Fold, labelled_minutes, load_folds
from flows.learn.labelled_recordings import LabelledRecording
from operators.errors import FingertipError, InputError

Having: TypeAlias = Callable[[Sequence[LabelledRecording]], Path]


def still(recording: LabelledRecording) -> LabelledRecording:
    return replace(recording, label=np.zeros_like(recording.label), name=f"still {recording.name}")


def test_each_group_is_held_out_once(surfaces: list[LabelledRecording], having: Having) -> None:
    data = load_folds(having(surfaces))
    assert (data.name, data.by) == ("strokes", "group")
    assert [fold.name for fold in data.folds] == ["steel", "wood", "wool"]
    assert sorted(place for fold in data.folds for place in fold.test) == list(range(9))
    for fold in data.folds:
        assert {data.recordings[place].group for place in fold.test} == {fold.name}
        assert fold.name not in {each.group for each in fold.train}
        assert len(fold.train) == 6
    assert data.leaks == ()


@pytest.mark.parametrize("group", ["", "steel"])
def test_with_fewer_than_two_groups_recordings_are_held_out_and_the_page_says_so(
    surfaces: list[LabelledRecording], having: Having, group: str
) -> None:
    data = load_folds(having([replace(each, group=group) for each in surfaces[:4]]))
    assert data.by == "recording"
    assert [fold.test for fold in data.folds] == [(0,), (1,), (2,), (3,)]
    assert "fewer than two surfaces" in data.notes[0]


def test_many_recordings_are_held_out_in_eight_parts(
    surfaces: list[LabelledRecording], having: Having
) -> None:
    data = load_folds(having([replace(each, group="") for each in surfaces]))
    assert [fold.name for fold in data.folds][:2] == ["part 1 of 8", "part 2 of 8"]
    assert data.folds[0].test == (0, 8)


def test_a_copy_on_another_surface_is_named(surfaces: list[LabelledRecording], having: Having) -> None:
    copy = replace(surfaces[0], group="wool", name="copy")
    [leak] = load_folds(having([*surfaces, copy])).leaks
    assert leak.kind == "shared rows"
    assert "steel-0 (steel) and copy (wool)" in leak.finding


def test_datasets_without_slip_static_or_a_second_recording_are_refused(
    surfaces: list[LabelledRecording], having: Having
) -> None:
    with pytest.raises(InputError, match="has no slip"):
        load_folds(having(list(map(still, surfaces))))
    with pytest.raises(InputError, match="has one recording"):
        load_folds(having(surfaces[:1]))
    other = replace(surfaces[1], fingertip=replace(surfaces[1].fingertip, unit="kPa"))
    with pytest.raises(FingertipError):
        load_folds(having([surfaces[0], other]))


def test_every_fifth_recording_validates(surfaces: list[LabelledRecording]) -> None:
    fit, validation = Fold("x", tuple(surfaces), ()).parts()
    assert len(fit) == 7
    assert [each.name for each in validation] == [surfaces[2].name, surfaces[7].name]


def test_if_few_recordings_have_slip_none_is_spared(surfaces: list[LabelledRecording]) -> None:
    few = [*surfaces[:4], *map(still, surfaces[4:])]
    assert Fold("x", tuple(few), ()).parts() == (few, few)


def test_labelled_minutes_are_drawn_from_the_other_folds(surfaces: list[LabelledRecording]) -> None:
    fold = Fold("x", (*map(still, surfaces[:5]), surfaces[5]), ())
    draws = [labelled_minutes(fold, 0.2, seed) for seed in range(5)]
    for found in draws:
        assert sum(map(len, found)) == 1200
        assert found[0].name == surfaces[5].name  # the only one with slip
        assert len(found[1].slip) == len(found[1].counts) == 500
    assert len({found[1].name for found in draws}) > 1
    assert sum(map(len, labelled_minutes(fold, 60, 0))) == 6 * 700
