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


def gaps(position: Position) -> list[tuple[str, int, int]]:
    return [(epoch, first, last) for _, epoch, first, last in position.gaps()]


@given(st.lists(st.integers(1, 20)))
def test_every_event_is_new_once(numbers: list[int]) -> None:
    position = Position(everything=True)
    taken = [number for number in numbers if position.take(event(number))]
    assert taken == list(dict.fromkeys(numbers))


def test_a_new_rig_starts_with_its_next_or_its_first_event() -> None:
    for everything, missed in (False, []), (True, [("ab", 1, 6)]):
        by_event, by_head = Position(everything=everything), Position(everything=everything)
        assert by_event.take(event(7))
        assert gaps(by_event) == missed
        assert by_head.announce(UR10, {"ab": 6}) == []
        assert gaps(by_head) == missed


def test_a_newer_head_reveals_gaps() -> None:
    position = Position()
    position.announce(UR10, {"ab": 5})
    position.take(event(7))
    position.announce(UR10, {"ab": 9})
    assert gaps(position) == [("ab", 6, 6)]
    position.take(event(6))
    assert gaps(position) == [("ab", 8, 9)]


def test_a_new_epoch_of_a_known_rig_is_missed_from_its_first_event() -> None:
    position = Position()
    position.announce(UR10, {"ab": 5})
    assert position.announce(UR10, {"ab": 6, "cd": 2}) == []
    assert gaps(position) == [("ab", 6, 6), ("cd", 1, 2)]


@pytest.mark.parametrize(
    "older", [{"ab": 5}, {"ab": 6, "cd": 2}, {"old": 4, "ab": 6, "cd": 3}, {"old": 4}], ids=str
)
def test_an_older_head_after_a_newer_one_changes_nothing(older: dict[str, int]) -> None:
    position = Position()
    position.announce(UR10, {"old": 4, "ab": 5})
    position.announce(UR10, {"ab": 6, "cd": 2})
    for number in range(1, 5):
        assert position.take(event(number, "cd"))
    position.announce(UR10, {"ab": 6, "cd": 4})
    before = position.encode()
    assert position.announce(UR10, older) == []
    assert position.encode() == before
    assert not position.take(event(3, "cd"))


def test_a_head_of_an_unknown_epoch_does_not_hide_later_heads_of_the_rig() -> None:
    position = Position()
    position.announce(UR10, {"ab": 5})
    position.announce(UR10, {"forged": 3})
    assert position.announce(UR10, {"ab": 5}) == []
    position.announce(UR10, {"ab": 7})
    assert ("ab", 6, 7) in gaps(position)


def test_a_new_rig_starts_with_its_next_event_in_all_epochs() -> None:
    position = Position()
    assert position.take(event(3, "cd"))
    position.announce(UR10, {"ab": 9, "cd": 4})
    assert gaps(position) == [("cd", 4, 4)]


def test_an_epoch_of_which_nothing_was_missed_is_dropped_without_a_report() -> None:
    position = Position()
    position.announce(UR10, {"ab": 5})
    position.announce(UR10, {"ab": 5, "cd": 1})
    assert position.announce(UR10, {"cd": 2}) == []


def test_missing_events_of_an_answer_are_reported_lost_once() -> None:
    position = Position(everything=True)
    position.announce(UR10, {"ab": 9})
    position.take(event(3))
    answer = GapAnswer("ab", 1, 5, ((1, 4),))
    assert position.settle(UR10, answer) == [
        "lab/ur10: events 1 to 2 of epoch ab are lost: no longer kept",
        "lab/ur10: event 4 of epoch ab is lost: no longer kept",
    ]
    assert position.settle(UR10, answer) == []
    assert gaps(position) == [("ab", 5, 9)]
    assert position.settle(("lab", "other"), answer) == []


def test_an_epoch_no_longer_kept_is_reported_with_its_lost_events() -> None:
    position = Position()
    position.announce(UR10, {"ab": 5})
    position.take(event(8))
    [lost] = position.announce(UR10, {"cd": 0})
    assert lost == ("lab/ur10: epoch ab is no longer kept; lost events: 6 to 7, any after 8")
    assert position.announce(UR10, {"cd": 0}) == []


def test_memory_is_bounded_and_given_up_gaps_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(position, "GAPS_MAX", 3)
    monkeypatch.setattr(position, "RIGS_MAX", 2)
    here, lost = Position(everything=True), list[str]()
    for number in range(1, 11):
        assert here.take(event(2 * number))
        lost += here.give_up()
    assert len(lost) == 8
    assert lost[0] == "lab/ur10: event 1 of epoch ab is lost: given up after too many gaps without an answer"
    here.announce(("lab", "a"), {"ab": 5})
    assert here.give_up() == []
    here.announce(("lab", "b"), {"ab": 5})
    assert here.give_up() == ["lab/ur10: position forgotten, because there are more than 2 rigs"]
    assert here.encode().count(b'"site"') == 2


def test_a_position_keeps_within_the_limit_of_its_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(position, "FILE_MAX", 10_000)
    here = Position(everything=True)
    for rig in range(9):
        for number in range(1, 400, 2):
            here.take(replace(event(number), rig=f"rig{rig}"))
    payload, forgotten = here.encode_limited()
    assert len(payload) <= 10_000
    assert forgotten[0].startswith("lab/rig0: ")
    put(tmp_path / "position", payload)
    assert load(tmp_path / "position").encode() == payload


def test_a_saved_position_is_loaded_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "position"
    before = load(path)
    before.announce(UR10, {"ab": 5})
    before.announce(UR10, {"ab": 9, "cd": 1})
    before.take(event(7))
    put(path, before.encode())
    after = load(path)
    assert gaps(after) == gaps(before) == [("ab", 6, 6), ("cd", 1, 1)]
    assert after.encode() == before.encode() == path.read_bytes()
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "content",
    [b"", b"{}", b'{"format":2,"rigs":[]}', b'{"format":1,"rigs":[{}]}', b"\0" * 100, b"[" * 10_000],
)
def test_a_malformed_file_is_an_error_with_a_remedy(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "position"
    path.write_bytes(content)
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
        b'{"epoch":"a","last_seq":1,"before":[' + b",".join([b"{}"] * 16) + b"]}",
    ],
)
def test_a_malformed_head_is_rejected(head: bytes) -> None:
    with pytest.raises(InputError, match=r"^here: "):
        read_heads(Fields.parse(head, "here"))
