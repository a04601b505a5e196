from math import inf
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from connectors import Event
from connectors.mqtt import position
from connectors.mqtt.gap_replay import GapAnswer
from connectors.mqtt.position import Position, RigId, load, lock_position, read_heads
from operators.errors import EndpointError, InputError, SlipflowError
from tests.connectors.mqtt.made import EVENT

UR10 = ("lab", "ur10")


def event(seq: int, epoch: str = "ab") -> Event:
    return replace(EVENT, seq=seq, epoch=epoch)


def missed(position: Position, rig: RigId = UR10) -> tuple[str, int, int] | None:
    """The first missed events of a rig, requested after a new connection."""
    position.reconnected()
    return position.request(rig, inf)


def settle(position: Position, answer: GapAnswer) -> list[str]:
    """Request events, and get an answer."""
    assert position.request(UR10, inf)
    return position.settle(UR10, answer)


@given(st.lists(st.tuples(st.sampled_from(["event", "head", "missing"]), st.integers(1, 20))))
def test_an_event_is_received_missed_or_lost_as_in_a_set_of_numbers(steps: list[tuple[str, int]]) -> None:
    position, settled, newest, lost = Position(everything=True), set[int](), 0, list[str]()
    for what, number in steps:
        if what == "event":
            assert position.has(event(number)) == (number in settled)
            assert not position.take(event(number))
            settled.add(number)
        elif what == "head":
            position.announce(UR10, {"ab": number})
        elif gap := missed(position):
            last = max(gap[1], number)
            lost += position.settle(UR10, GapAnswer("ab", gap[1], last, ((gap[1], last),)))
            settled |= {*range(gap[1], min(last, newest) + 1)}
        newest = max(newest, number if what != "missing" else 0)
        absent = [n for n in range(1, newest + 1) if n not in settled]
        end = next((n for n in range(absent[0], newest + 1) if n in settled), newest + 1) if absent else 0
        assert missed(position) == (("ab", absent[0], end - 1) if absent else None)
    again = Position.decode(position.encode(), "here", everything=True)
    assert again.encode() == position.encode()


EPOCHS = st.sampled_from(["ab", "cd", "ef", "gh"])


@given(st.lists(st.tuples(st.dictionaries(EPOCHS, st.integers(0, 9), min_size=1), st.integers(1, 9))))
def test_no_head_brings_back_an_event_or_reports_a_loss(steps: list[tuple[dict[str, int], int]]) -> None:
    position, received = Position(), list[Event]()
    position.announce(UR10, {"ab": 0})
    for heads, number in steps:
        position.announce(UR10, heads)
        received.append(event(number, next(iter(heads))))
        assert not position.take(received[-1])
        assert all(position.has(each) for each in received)


def test_a_new_rig_starts_with_its_next_or_its_first_event() -> None:
    for everything, expected in (False, None), (True, ("ab", 1, 6)):
        by_event, by_head = Position(everything=everything), Position(everything=everything)
        by_event.take(event(7))
        by_head.announce(UR10, {"ab": 6})
        assert missed(by_event) == missed(by_head) == expected
        by_event.announce(UR10, {"old": 9, "ab": 8})
        assert missed(by_event) == (("ab", 1, 6) if everything else ("ab", 8, 8))


def test_missing_events_of_an_answer_are_reported_lost_once_and_only_if_they_were_missed() -> None:
    position = Position(everything=True)
    position.announce(UR10, {"ab": 9})
    position.take(event(3))
    answer = GapAnswer("ab", 1, 5, ((1, 4),))
    assert not position.settle(UR10, answer)  # nothing was requested
    assert settle(position, answer) == [
        "lab/ur10: events 1 to 2 of epoch ab are lost: no longer kept",
        "lab/ur10: event 4 of epoch ab is lost: no longer kept",
    ]
    assert not position.settle(UR10, answer)
    assert not settle(position, GapAnswer("ab", 5, 9, ((7, 9),)))  # events 5 and 6 did not arrive
    assert missed(position) == ("ab", 5, 9)


def test_a_request_is_repeated_after_3_s_and_at_once_after_an_answer_of_use() -> None:
    position, asked = Position(everything=True), list[tuple[str, int, int] | None]()
    position.announce(UR10, {"ab": 9, "cd": 9})
    for now in (0.0, 2.9, 3.0, 6.0):
        asked.append(position.request(UR10, now))
    assert asked == [("ab", 1, 9), None, ("cd", 1, 9), ("ab", 1, 9)]
    position.settle(UR10, GapAnswer("ab", 1, 9, ()))  # without its events: of no use
    assert position.request(UR10, 6.1) is None
    position.take(event(1))
    assert position.request(UR10, 9.0) == ("ab", 2, 9)
    position.take(event(2))
    position.settle(UR10, GapAnswer("ab", 2, 2, ()))
    assert position.request(UR10, 9.1) == ("ab", 3, 9)


def test_the_memory_of_a_rig_is_bounded_and_what_is_given_up_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(position, "AHEAD_MAX", 3)
    here, lost = Position(everything=True), list[str]()
    for number in range(1, 11):
        lost += here.take(event(2 * number))
    assert len(lost) == 7
    assert lost[0] == "lab/ur10: event 1 of epoch ab is lost: given up after too many gaps without an answer"
    for number in range(200):
        here.announce(UR10, {f"{number}": 1})
    assert here.encode().count(b'"epoch"') == position.EPOCHS_MAX


@pytest.mark.parametrize(
    "malformed",
    [
        *(b"", b"{}", b'{"format":1,"rigs":[]}', b'{"format":2,"rigs":[{}]}', b"\0" * 100, b"[" * 10_000),
        b'{"format":2,"rigs":[{"site":"lab","rig":"ur10","epoch":"a","done":5,"head":9,"ahead":[6]}]}',
    ],
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
        read_heads(head, "here")
