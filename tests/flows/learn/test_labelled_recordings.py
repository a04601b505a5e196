"""Simulated recordings: their data in addition to counts and labels."""

from dataclasses import replace
from pathlib import Path
from shutil import copytree
from typing import TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray

from connectors import SimulatedRig
from connectors.sim.scene import Move, Scene
from flows.graph import Flow
from flows.learn.evaluation.stress_study import stressed
from flows.learn.labelled_recordings import (
    TURNS,
    LabelledRecording,
    common_fingertip,
    load,
    simulated_recording,
)
from flows.learn.training.trained_model import provenance
from operators import Align, Label, Touch, Zero, ms, s
from operators.errors import FingertipError, InputError
from operators.fingertip import TAKKTILE
from storage import Dataset, LabelSpan, Session
from storage.files import put_checked, read_checked
from tests.flows.run.live import execute
from tests.storage.made import record

Part = TypeVar("Part")
SCENE = Scene(
    (
        Move("hold", 1.2, force=0.0),
        Move("hold", 0.8, force=0.5),
        Move("translation", 0.9, 0.3, 0.0, 0.1),
        Move("translation", 0.9, 0.3, 45.0, 0.1),
        Move("hold", 1.0, force=0.0),
    )
)


def there(part: Part | None) -> Part:
    assert part is not None
    return part


def slides(recording: LabelledRecording) -> NDArray[np.intp]:
    """Return the samples at which the contact truly slides."""
    sliding = there(recording.sliding)
    assert len(sliding) == len(recording)
    assert set(sliding.tolist()) == {-1, 0, 1}
    return np.flatnonzero(sliding == 1)


def test_the_truth_of_a_sample_is_that_of_its_own_instant_even_where_others_were_lost() -> None:
    whole, thinned = (simulated_recording(SCENE, 3), simulated_recording(stressed(SCENE, "lost", 0.3), 3))
    assert 0.6 < len(thinned) / len(whole) < 0.8
    assert len(there(thinned.strokes).oblique) == len(thinned)
    kept = slides(thinned)
    # the thinned samples keep their place in the recording, in proportion
    share = np.array([kept[0], kept[-1]]) / len(thinned) * len(whole) / 100  # s
    sliding = slides(whole) / 100  # s
    assert share == pytest.approx([sliding[0], sliding[-1]], abs=0.15)


def test_a_wrong_clock_of_the_touch_moves_the_arm_speed_label_but_not_the_truth() -> None:
    nominal, late = (simulated_recording(scene, 3) for scene in (SCENE, stressed(SCENE, "clock", 0.1)))
    assert slides(nominal).tolist() == slides(late).tolist()
    assert np.flatnonzero(late.slip)[0] == np.flatnonzero(nominal.slip)[0] - 10


def test_a_recording_of_a_live_flow_has_the_sliding_labels_of_its_scene(tmp_path: Path) -> None:
    rig, flow, dataset = SimulatedRig(SCENE, 3), Flow("sliding"), Dataset(tmp_path)
    flow.source(rig.truth).to(dataset)
    ((flow.source(rig.touch) | Zero()) & flow.source(rig.motion) | Align() | Label()).to(dataset)
    execute(flow, start=0)
    [recorded] = load(tmp_path)
    slides(recorded)
    assert there(recorded.sliding).tolist() == there(simulated_recording(SCENE, 3).sliding).tolist()


def test_recordings_without_splits_take_turns_by_session_also_if_given_one_by_one(
    tiny: Path, tmp_path: Path
) -> None:
    copy = copytree(tiny, tmp_path / "tiny")
    for path in copy.glob("sessions/*/session.json"):
        put_checked(path, {**read_checked(path), "split": None})
    last = max((copy / "sessions").iterdir())
    last.rename(f"{last}-renamed")
    assert load(copy)[-1].name == f"{last.name}-renamed"
    turns = [each.split for each in load(copy)]
    assert turns == list((TURNS * 2)[: len(turns)]) != [each.split for each in load(tiny)]
    one_by_one = load(*sorted((copy / "sessions").iterdir()))
    assert [(each.name, each.split) for each in one_by_one] == [
        (each.name, each.split) for each in load(copy)
    ]
    assert load(tiny, copy)[-1].split == one_by_one[-1].split
    unlabelled = record(copy, [Touch.rows([s], np.zeros((1, 6)), 0, True, finger=0)]).folder
    unlabelled.rename(unlabelled.with_name("a"))
    assert [each.split for each in load(copy)] == turns


def test_labels_by_hand_replace_those_by_arm_speed_and_not_the_truth(tiny: Path, tmp_path: Path) -> None:
    copy = copytree(tiny, tmp_path / "tiny")
    before = load(copy)
    name = before[0].name
    session = Session.open(copy / "sessions" / name)
    time = session.frame("samples")["time"]
    marks = (LabelSpan(time[300], time[400], 0, "slip"), LabelSpan(time[400], time[410], 0, "unknown"))
    session.write_hand_labels(marks, based_on=0)
    first, *others = load(copy)
    assert set(first.label[300:400].tolist()) == {1}
    assert set(first.label[400:410].tolist()) == {-1}
    assert first.label[410:].tolist() == before[0].label[410:].tolist()
    assert first.sliding is not None
    assert before[0].sliding is not None
    assert first.sliding.tolist() == before[0].sliding.tolist()
    assert provenance([first, *others]) == provenance(before), "the content is the same"


def test_a_session_without_an_arm_has_the_labels_by_hand_only(tmp_path: Path) -> None:
    count, start = 600, 1_700_000_000 * s
    time = start + np.arange(count) * 10 * ms
    session = record(tmp_path, [Touch.rows(time, np.full((count, 6), 700), 700, True, finger=2)])
    with pytest.raises(InputError, match="or label by hand with `slipflow show`"):
        load(tmp_path)
    session.write_hand_labels([LabelSpan(time[300], time[500], 2, "static")], based_on=0)
    [recording] = load(tmp_path)
    assert len(recording) == count
    assert recording.label.tolist() == [-1] * 300 + [0] * 200 + [-1] * 100
    assert recording.fingertip.cells == 6


def test_a_session_whose_fingertip_is_unknown_is_refused_with_the_remedy(tmp_path: Path) -> None:
    session = record(tmp_path, [Touch.rows([s] * 200, np.zeros((200, 6)), 0, True, finger=0)])
    session.write_hand_labels([LabelSpan(s, 2 * s, 0, "slip")], based_on=0)
    with pytest.raises(InputError, match=r"does not state its fingertip, .*: record or import it again"):
        load(tmp_path)


def test_recordings_of_different_known_ranges_are_not_used_together() -> None:
    counts, label = np.zeros((1, 6), np.int16), np.zeros(1, np.int8)
    unknown, known, finer = (
        LabelledRecording(counts, label, fingertip=replace(TAKKTILE, range=each))
        for each in (None, TAKKTILE.range, (4092, 0))
    )
    assert common_fingertip([unknown, known]) == TAKKTILE
    with pytest.raises(FingertipError, match=r"range \(1023, 0\); .*: Pool\(gain=0\.25, unit='count'\)"):
        common_fingertip([unknown, known, finer])


def test_a_piece_has_the_same_samples_of_every_column(tiny: Path) -> None:
    whole = load(tiny)[0]
    piece = whole.piece(slice(100, 300))
    assert len(piece.counts) == len(piece.label) == len(there(piece.valid)) == 200
    assert piece.counts.tolist() == whole.counts[100:300].tolist()
    assert (piece.sliding is None) == (whole.sliding is None)
    assert piece.strokes is None
