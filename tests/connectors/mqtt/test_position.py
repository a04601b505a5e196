import os
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors import Event
from connectors.fields import Fields
from connectors.mqtt import position
from connectors.mqtt.gap_replay import GapAnswer
from connectors.mqtt.position import Position, load, lock_position, read_heads
from operators.errors import EndpointError, InputError, SlipflowError
from storage.files import put

UR10 = ("lab", "ur10")
EVENT = Event("lab", "ur10", "0", "ab", 1, onset=True, time=1, probability=0.9, latency=1.0)


def event(seq: int, epoch: str = "ab") -> Event:
    return replace(EVENT, seq=seq, epoch=epoch)


def content(position: Position) -> bytes:
    return position.encode()


@given(st.lists(st.tuples(st.sampled_from(["event", "head", "missing"]), st.integers(1, 20))))
def test_an_event_is_received_missed_or_lost_as_in_a_set_of_numbers(steps: list[tuple[str, int]]) -> None:
    position, settled, newest, lost = Position(everything=True), set[int](), 0, list[str]()
    for what, number in steps:
        if what == "event":
            assert position.has(event(number)) == (number in settled)
            assert not position.take(event(number))
            settled.add(number)
        elif what == "head":
            assert not position.announce(UR10, {"ab": number})
        else:
            first = next((n for n in range(1, newest + 1) if n not in settled), 0)
            lost += position.settle(UR10, GapAnswer("ab", first, number, ((first, number),)))
            settled |= {*range(first, min(number, newest) + 1)} if first else set()
        newest = max(newest, number if what != "missing" else 0)
        missed = [n for n in range(1, newest + 1) if n not in settled]
        gap = position.gap(UR10)
        assert (gap is None) == (not missed)
        if gap:
            end = next((n for n in range(missed[0], newest + 1) if n in settled), newest + 1) - 1
            assert gap == ("ab", missed[0], end)
    again = Position.decode(content(position), "here", everything=True)
    assert content(again) == content(position)


def test_a_new_rig_starts_with_its_next_or_its_first_event() -> None:
    for everything, missed in (False, None), (True, ("ab", 1, 6)):
        by_event, by_head = Position(everything=everything), Position(everything=everything)
        by_event.take(event(7))
        by_head.announce(UR10, {"ab": 6})
        assert by_event.gap(UR10) == by_head.gap(UR10) == missed
    by_event.announce(UR10, {"old": 9, "ab": 7})
    assert by_event.gap(UR10) == ("old", 1, 9)


def test_a_new_epoch_of_a_known_rig_is_missed_from_its_first_event() -> None:
    position = Position()
    position.announce(UR10, {"ab": 5})
    assert not position.announce(UR10, {"ab": 5, "cd": 2})
    assert position.gap(UR10) == ("cd", 1, 2)


@pytest.mark.parametrize("older", [{"ab": 5}, {"old": 4, "ab": 6}, {"old": 4}, {"ab": 6, "cd": 2}], ids=str)
def test_an_older_head_after_a_newer_one_changes_nothing(older: dict[str, int]) -> None:
    position = Position()
    position.announce(UR10, {"old": 4, "ab": 5})
    position.announce(UR10, {"ab": 6, "cd": 2})
    for number in range(1, 5):
        position.take(event(number, "cd"))
    position.announce(UR10, {"ab": 6, "cd": 4})
    before = content(position)
    assert position.announce(UR10, older) == []
    assert content(position) == before


def test_a_head_of_an_unknown_epoch_does_not_hide_later_heads_of_the_rig() -> None:
    position = Position()
    position.announce(UR10, {"ab": 5})
    position.announce(UR10, {"forged": 3})
    assert position.announce(UR10, {"ab": 5}) == []
    position.announce(UR10, {"ab": 7})
    assert position.gap(UR10) == ("ab", 6, 7)


def test_missing_events_of_an_answer_are_reported_lost_once_and_only_if_they_were_missed() -> None:
    position = Position(everything=True)
    position.announce(UR10, {"ab": 9})
    position.take(event(3))
    answer = GapAnswer("ab", 1, 5, ((1, 4),))
    assert position.settle(UR10, answer) == [
        "lab/ur10: events 1 to 2 of epoch ab are lost: no longer kept",
        "lab/ur10: event 4 of epoch ab is lost: no longer kept",
    ]
    assert position.settle(UR10, answer) == []
    assert position.settle(UR10, GapAnswer("ab", 7, 9, ((7, 9),))) == []  # events 5 and 6 are still missed
    assert position.gap(UR10) == ("ab", 5, 9)
    assert position.settle(("lab", "other"), answer) == []


def test_an_epoch_no_longer_kept_is_reported_only_if_events_may_be_lost() -> None:
    position = Position()
    position.announce(UR10, {"ab": 5, "empty": 0})
    position.take(event(8))
    assert position.announce(UR10, {"ab": 8, "cd": 0}) == []
    position.announce(UR10, {"ab": 10, "cd": 3})
    for number in range(1, 4):
        position.take(event(number, "cd"))
    assert position.announce(UR10, {"ef": 0}) == [
        "lab/ur10: events 6 to 7 of epoch ab are lost: no longer kept",
        "lab/ur10: events 9 to 10 of epoch ab are lost: no longer kept",
        "lab/ur10: epoch cd is no longer kept; events after 3 may be lost",
    ]
    assert position.announce(UR10, {"ef": 0}) == []


def test_memory_is_bounded_and_what_is_given_up_for_it_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(position, "AHEAD_MAX", 3)
    monkeypatch.setattr(position, "SIZE_MAX", 49)
    here, lost = Position(everything=True), list[str]()
    for number in range(1, 11):
        lost += here.take(event(2 * number))
    assert len(lost) == 7
    assert lost[0] == "lab/ur10: event 1 of epoch ab is lost: given up after too many gaps without an answer"
    assert here.announce(("lab", "a"), {"ab": 5}) == []
    here.take(event(15))
    assert here.announce(("lab", "b"), {"ab": 5}) == [
        "lab/a: position forgotten, because there are too many rigs and epochs"
    ]
    assert here.rigs() == [UR10, ("lab", "b")]
    put(tmp_path / "position", content(here))
    assert content(load(tmp_path / "position")) == content(here)


@pytest.mark.parametrize(
    "malformed",
    [b"", b"{}", b'{"format":1,"rigs":[]}', b'{"format":2,"rigs":[{}]}', b"\0" * 100, b"[" * 10_000],
)
def test_a_malformed_file_is_an_error_with_a_remedy(tmp_path: Path, malformed: bytes) -> None:
    path = tmp_path / "position"
    path.write_bytes(malformed)
    with pytest.raises(InputError, match=rf"^{path}: .*delete it to start over$"):
        load(path)


def test_a_missing_folder_is_an_error_of_one_line(tmp_path: Path) -> None:
    with pytest.raises(EndpointError, match=r"position: cannot be written: No such file or directory$"):
        lock_position(tmp_path / "absent" / "position")
    with pytest.raises(SlipflowError, match=r"cannot be read: Is a directory|is not a regular file"):
        load(tmp_path)


def test_a_position_file_in_use_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    held = lock_position(tmp_path / "position")
    with pytest.raises(EndpointError, match=r"position: is in use by another consumer; name another file$"):
        lock_position(tmp_path / "position")
    os.close(held)
    os.close(lock_position(tmp_path / "position"))


@pytest.mark.parametrize(
    "head",
    [
        b'{"epoch":"a"}',
        b'{"epoch":"a","last_seq":-1}',
        b'{"epoch":"a","last_seq":1,"before":7}',
        b'{"epoch":"a","last_seq":1,"before":[{"epoch":"b"}]}',
        b'{"epoch":"a","last_seq":1,"before":[' + b",".join([b"{}"] * 200) + b"]}",
    ],
)
def test_a_malformed_head_is_rejected(head: bytes) -> None:
    with pytest.raises(InputError, match=r"^here: "):
        read_heads(Fields.parse(head, "here"))
