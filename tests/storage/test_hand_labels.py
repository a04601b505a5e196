"""Labels by hand: numbered versions that are never changed."""

from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from operators import InputError, ParameterError
from operators.batch import SLIP, STATIC, UNKNOWN
from storage import HandLabels, LabelSpan, Session, recover, verify
from storage.files import read_json
from tests.storage.made import contents, new_samples, record

SPANS = (
    LabelSpan(30, 50, 0, "slip", "Ada", "edge", 7),
    LabelSpan(0, 30, 0, "static"),
    LabelSpan(0, 9, 1, "slip"),
)


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return record(tmp_path, [new_samples(range(0, 100, 10), finger) for finger in (0, 1)])


def test_each_version_is_a_new_file_based_on_the_newest_and_nothing_else_changes(session: Session) -> None:
    assert (session.hand_labels().version, session.hand_labels().spans) == (0, ())
    before = contents(session.folder)
    session.write_hand_labels(SPANS, based_on=0)
    first = contents(session.folder)
    assert session.hand_labels().spans == (SPANS[1], SPANS[0], SPANS[2])  # by fingertip and time
    with pytest.raises(InputError, match="has version 1 of hand labels, not 0"):
        session.write_hand_labels((), based_on=0)
    assert contents(session.folder) == first
    session.write_hand_labels(SPANS[:1], based_on=1)
    after = contents(session.folder)
    assert {path: after[path] for path in before} == before
    assert {path: after[path] for path in first} == first
    assert sorted(set(after) - set(before)) == ["labels/000001.json", "labels/000002.json"]
    assert session.hand_labels().spans == SPANS[:1]
    assert verify(session.folder).code == 0


def test_a_span_replaces_the_labels_of_its_samples_only() -> None:
    time, label = np.arange(0, 60, 10), np.full(6, STATIC, np.int8)
    spans = (LabelSpan(10, 30, 0, "slip"), LabelSpan(50, 60, 0, "unknown"), LabelSpan(0, 60, 1, "slip"))
    found = HandLabels(1, spans).replace(label, time, 0)
    assert found.tolist() == [STATIC, SLIP, SLIP, STATIC, STATIC, UNKNOWN]
    assert set(label.tolist()) == {STATIC}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((20, 20, 0, "slip"), "end is 20, must be after begin"),
        ((0, 2**63, 0, "slip"), "end is"),
        ((0, 1, -2, "slip"), "finger is -2"),
        ((0, 1, 0, "slip", "", "", -1), "created is -1"),
        ((0, 1, 0, "sliding"), "value is 'sliding', must be one of slip, static, unknown"),
    ],
)
def test_an_invalid_span_is_an_error(values: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        LabelSpan(*values)


def test_overlapping_spans_are_an_error_and_write_nothing(session: Session) -> None:
    with pytest.raises(ParameterError, match="begin is 20, must be at least 30 ns"):
        session.write_hand_labels([LabelSpan(0, 30, 0, "slip"), LabelSpan(20, 40, 0, "static")], based_on=0)
    many = (LabelSpan(number, number + 1, 0, "slip") for number in count())
    with pytest.raises(ParameterError, match="number of spans is 100001, must be at most 100,000"):
        session.write_hand_labels(many, based_on=0)
    assert not (session.folder / "labels").exists()


def test_a_damaged_version_and_a_file_edited_by_hand_are_found(session: Session) -> None:
    session.write_hand_labels(SPANS, based_on=0)
    path = session.folder / "labels/000001.json"
    whole, check = path.read_text(), read_json(path)["check"]
    path.write_text(whole.replace('"begin": 30', '"begin": 31'))
    [finding] = verify(session.folder).findings
    assert (finding.weight, "000001.json: is damaged" in finding.text) == ("lost", True)
    with pytest.raises(InputError, match="is damaged"):
        session.hand_labels()
    edited = whole.replace(f',\n  "check": "{check}"', "")
    path.write_text(edited)
    assert session.hand_labels().version == 1
    path.write_text(edited.replace('"begin": 30', '"begin": 3.5'))
    with pytest.raises(InputError, match="has an invalid span: 'float' object cannot be"):
        session.hand_labels()


def test_a_recovery_deletes_what_a_killed_writer_left(session: Session) -> None:
    session.write_hand_labels(SPANS, based_on=0)
    scratch = session.folder / "labels/000002.json.tmp"
    scratch.write_text("{")
    assert recover(session.folder).done == ["1 incomplete files were deleted"]
    assert session.hand_labels().version == 1
    assert not scratch.exists()
