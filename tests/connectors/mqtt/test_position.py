from math import inf
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from connectors import Event
from connectors.mqtt import position
from connectors.mqtt.gap_replay import GapAnswer
from connectors.mqtt.position import FILE_MAX, SIZE_MAX, Position, RigId, load, lock_position, read_heads
from operators.errors import EndpointError, InputError, SlipflowError
from tests.connectors.mqtt.made import EVENT

UR10 = ("lab", "ur10")


def event(seq: int, epoch: str = "ab") -> Event:
    return replace(EVENT, seq=seq, epoch=epoch)


def missed(position: Position, rig: RigId = UR10) -> tuple[str, int, int] | None:
    """The first missed events of a rig, requested after a new connection."""
    position.reconnected()
    return position.request(rig, inf)


def settle(position: Position, answer: GapAnswer, now: float = inf) -> list[str]:
    """Request events, and get an answer."""
    assert position.request(UR10, now)
    return position.settle(UR10, answer, now)


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
        elif gap := missed(position):
            last = max(gap[1], number)
            lost += position.settle(UR10, GapAnswer("ab", gap[1], last, ((gap[1], last),)), inf)
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
        assert not position.announce(UR10, heads)
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
    assert not position.settle(UR10, answer, 0.0)  # nothing was requested
    assert settle(position, answer) == [
        "lab/ur10: events 1 to 2 of epoch ab are lost: no longer kept",
        "lab/ur10: event 4 of epoch ab is lost: no longer kept",
    ]
    assert not position.settle(UR10, answer, 0.0)
    assert not settle(position, GapAnswer("ab", 5, 9, ((7, 9),)))  # events 5 and 6 did not arrive
    assert missed(position) == ("ab", 5, 9)


@pytest.mark.parametrize("returns", ["never", "head", "event"])
def test_an_epoch_that_is_not_announced_is_lost_unless_it_returns_within_30_s(returns: str) -> None:
    position = Position()
    position.announce(UR10, {"ab": 5})
    position.announce(UR10, {"ab": 7})
    position.announce(UR10, {"cd": 1})  # of a new outbox, or of another rig of this name
    answer = GapAnswer("ab", 6, 7, ((6, 7),))
    assert not settle(position, answer, 100.0)
    assert position.request(UR10, 103.0) == ("cd", 1, 1), "which does not wait for the other epoch"
    if returns == "head":
        position.announce(UR10, {"ab": 7})
        position.announce(UR10, {"cd": 0})
    elif returns == "event":
        position.take(event(9))
    lost = settle(position, answer, 131.0)
    assert lost == (["lab/ur10: events 6 to 7 of epoch ab are lost: no longer kept"] * (returns == "never"))


def test_requests_become_rarer_until_they_are_answered() -> None:
    position, asked, now = Position(everything=True), list[float](), 0.0
    position.announce(UR10, {"ab": 9})
    while now < 200:
        asked += [now] if position.request(UR10, now) else []
        now += 1.0
    assert asked == [0, 3, 9, 21, 45, 93, 153]
    position.announce(UR10, {"ab": 9, "cd": 9})  # forged numbers hide no other epoch
    assert [position.request(UR10, 1000.0 * turn) for turn in (1, 2)] == [("cd", 1, 9), ("ab", 1, 9)]
    now = 2010.0
    assert not position.settle(UR10, GapAnswer("ab", 1, 9, ()), now)  # without its events: of no use
    assert position.request(UR10, now) is None
    position.take(event(1))  # it is there
    assert position.request(UR10, now)
    position.take(event(2))
    position.settle(UR10, GapAnswer("ab", 2, 2, ()), now)
    assert position.request(UR10, now)


def test_a_rig_that_starts_again_and_again_brings_back_no_old_event() -> None:
    position, kept = Position(), {f"old{number}": 50 for number in range(99)}
    for number in range(100):
        assert not position.announce(UR10, {**kept, f"new{number}": 0})
        assert missed(position) is None


def test_forged_rigs_and_epochs_do_not_displace_a_rig_that_delivers() -> None:
    position = Position()
    position.announce(UR10, {"ab": 5})
    position.take(event(6))
    position.announce(UR10, {"ab": 9})
    for number in range(300):
        forged = {f"{number}-{each}": 9 for each in range(100)}
        assert not position.announce(("lab", f"rig{number}"), forged)
        assert not position.announce(UR10, forged)
    assert len(position.encode()) < 2**20
    assert len(position.rigs) < 101
    again = Position.decode(position.encode(), "here")
    assert again.encode() == position.encode()
    for each in position, again:
        assert each.has(event(6))
        assert not each.has(event(7))
        assert not each.announce(UR10, {"ab": 9})
        assert missed(each) == ("ab", 7, 9)


def test_a_position_of_the_longest_names_can_be_read_again() -> None:
    position, wide = Position(), "\N{SNAKE}" * 62
    epochs = {f"{wide}{number:02}": 2**63 - 1 for number in range(99)}
    for number in range(SIZE_MAX // 20 // len(epochs)):
        position.announce((wide, f"{wide}{number:02}"), epochs)
    assert len(position.encode()) < FILE_MAX
    assert Position.decode(position.encode(), "here").rigs == position.rigs


def test_what_is_given_up_to_bound_the_memory_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(position, "AHEAD_MAX", 3)
    monkeypatch.setattr(position, "SIZE_MAX", 49)
    here, lost = Position(everything=True), list[str]()
    for number in range(1, 11):
        lost += here.take(event(2 * number))
    assert len(lost) == 7
    assert lost[0] == "lab/ur10: event 1 of epoch ab is lost: given up after too many gaps without an answer"
    assert not here.take(replace(EVENT, rig="b"))
    assert here.take(replace(EVENT, rig="c")) == ["lab/ur10: position forgotten: too many rigs and epochs"]


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
