import json
import struct
import zlib
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, cast

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from operators.batch import (
    Batch,
    Clocks,
    Episodes,
    Faults,
    Labelled,
    Motion,
    Slips,
    Touch,
    Truth,
    Zeroed,
    columns,
    concat,
)
from operators.errors import InputError
from storage import journal_segment
from storage.journal_segment import Damage, NumberedRows, read_segment
from tests.storage.made import new_batch

KINDS = [Touch, Zeroed, Motion, Labelled, Slips, Faults, Clocks, Episodes, Truth]


def segment(bodies: Sequence[bytes], salt: bytes | None = None) -> bytes:
    data = salt or journal_segment.new_salt()
    for body in (journal_segment.describe("one", 3), *bodies):
        data += journal_segment.seal(body, data[: journal_segment.SALT_SIZE], len(data))
    return data


def read(data: bytes) -> journal_segment.Segment:
    return read_segment(data, "000003.wal", "one", 3)


def bits(batch: Batch) -> list[bytes]:
    return [getattr(batch, name).tobytes() for name in columns(type(batch))]


@pytest.fixture(scope="module")
def written() -> list[NumberedRows]:
    return [NumberedRows(10 * n, new_batch(kind, n + 1, finger=n, seed=n)) for n, kind in enumerate(KINDS)]


@pytest.fixture(scope="module")
def data(written: list[NumberedRows]) -> bytes:
    return segment(list(journal_segment.bodies(written)))


def test_a_frame_is_as_the_format_says() -> None:
    salt, body, place = journal_segment.new_salt(), b"body", 4711
    checked = salt + struct.pack("<QI", place, len(body)) + body
    written = b"SLIP" + struct.pack("<II", len(body), zlib.crc32(checked)) + body
    assert journal_segment.seal(body, salt, place) == written
    assert (salt[:8], len(salt)) == (b"SLIPWAL1", 16)


def is_prefix(found: journal_segment.Segment, written: list[NumberedRows]) -> bool:
    return [(rows.first, bits(rows.batch)) for rows in found.rows] == [
        (rows.first, bits(rows.batch)) for rows in written[: len(found.rows)]
    ]


def single(kind: type[Batch], given: list[NumberedRows]) -> list[tuple[int, int, object]]:
    """The rows of a kind one by one: those that follow on each other may have come to share a frame."""
    return [
        (first + row, batch.finger, bits(batch[row : row + 1]))
        for first, batch in given
        if type(batch) is kind
        for row in range(len(batch))
    ]


@given(drawn=st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 9), st.integers(0, 2**40))))
@example(drawn=[(Touch, 1, 7), (Touch, 1, 8), (Touch, 3, 11), (Touch, 2, 9)])
def test_rows_come_back_bit_for_bit(drawn: list[tuple[type[Batch], int, int]]) -> None:
    written = [
        NumberedRows(first, new_batch(kind, rows, finger=rows % 3, seed=rows)) for kind, rows, first in drawn
    ]
    found = read(segment(list(journal_segment.bodies(written))))
    assert found.damage is None
    for kind in KINDS:
        assert single(kind, found.rows) == single(kind, written)


def test_a_large_batch_becomes_several_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_segment, "LIMIT", 3000)
    batch = new_batch(Motion, 200)
    found = read(segment(list(journal_segment.bodies([NumberedRows(7, batch)]))))
    assert len(found.rows) > 5
    assert [rows.first for rows in found.rows] == [7 + 26 * n for n in range(len(found.rows))]
    assert concat(Motion, [cast("Motion", rows.batch) for rows in found.rows]).velocity.tobytes() == (
        batch.velocity.tobytes()
    )


def test_rows_that_follow_on_each_other_share_a_frame() -> None:
    touch = [new_batch(Touch, 2, start=n, finger=int(n > 3), seed=n) for n in range(6)]
    motion = [new_batch(Motion, 1, start=n, seed=n) for n in range(6)]
    written = [NumberedRows(2 * n, touch[n]) for n in range(6)]
    written[2:2] = [NumberedRows(n + (n > 3), motion[n]) for n in range(6)]  # one number is missing
    found = read(segment(list(journal_segment.bodies(written)))).rows
    assert sorted((type(rows.batch).__name__, rows.first, len(rows.batch)) for rows in found) == [
        ("Motion", 0, 4),
        ("Motion", 5, 2),
        ("Touch", 0, 8),
        ("Touch", 8, 4),
    ]
    felt = [rows.batch for rows in found if isinstance(rows.batch, Touch)]
    assert b"".join(each.counts.tobytes() for each in felt) == b"".join(t.counts.tobytes() for t in touch)


def test_wherever_it_is_cut_a_prefix_is_left(data: bytes, written: list[NumberedRows]) -> None:
    counts: list[int] = []
    for end in range(len(data)):
        found = read(data[:end])
        assert is_prefix(found, written)
        counts.append(len(found.rows))
        if found.damage:
            assert found.damage.offset + found.damage.size == end
            assert found.damage.more == (found.damage.offset == 0 and end > journal_segment.SALT_SIZE)
    assert counts == sorted(counts)
    assert set(counts) == set(range(len(KINDS)))


@pytest.mark.parametrize("filling", ["zeros", "garbage", "repeated"])
def test_whatever_fills_the_tail_no_row_is_made_up(
    data: bytes, written: list[NumberedRows], filling: str
) -> None:
    for end in range(0, len(data), 7):
        left = len(data) - end
        tail = {
            "zeros": bytes(left),
            "garbage": bytes(37 * n % 251 for n in range(left)),
            "repeated": (data[journal_segment.SALT_SIZE : end] * left)[:left],
        }[filling]
        found = read(data[:end] + tail)
        assert is_prefix(found, written)
        assert len(found.rows) < len(written)
        assert found.damage is not None


@pytest.mark.parametrize("bit", range(8))
def test_a_flipped_bit_anywhere_is_noticed_and_leaves_a_prefix(
    data: bytes, written: list[NumberedRows], bit: int
) -> None:
    for place in range(len(data)):
        flipped = bytearray(data)
        flipped[place] ^= 1 << bit
        found = read(bytes(flipped))
        assert found.damage is not None
        assert found.damage.offset <= place
        assert is_prefix(found, written)


def test_damage_before_whole_frames_differs_from_a_cut_off_end(data: bytes) -> None:
    middle, end = bytearray(data), bytearray(data)
    middle[len(data) // 2] ^= 1
    end[-1] ^= 1
    for flipped, more in ((middle, True), (end, False)):
        damage = read(bytes(flipped)).damage
        assert isinstance(damage, Damage)
        assert damage.more is more


def test_a_frame_from_elsewhere_is_never_valid() -> None:
    body = next(journal_segment.bodies([NumberedRows(0, new_batch(Touch, 3))]))
    one, other = segment([body, body, body]), segment([body, body, body])
    size = (len(one) - len(segment([]))) // 3
    start = len(one) - 2 * size
    recycled = one[:start] + other[start:]  # the same place in an older file
    moved = one[:start] + one[start + size :] + one[start : start + size]
    for forged in (recycled, moved):
        assert len(read(forged).rows) == 1
    assert len(read(one).rows) == 3
    assert one[start:] != one[start - size : start + size]


def test_a_body_that_says_it_is_too_long_is_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    data = segment([bytes(1000)])
    monkeypatch.setattr(journal_segment, "LIMIT", 900)
    assert read(data).damage is not None


def said(**changes: object) -> bytes:
    """The segment of another slipflow."""
    body = journal_segment.describe("one", 3)
    about: dict[str, Any] = json.loads(body[15:]) | changes
    salt = journal_segment.new_salt()
    return salt + journal_segment.seal(body[:15] + json.dumps(about).encode(), salt, len(salt))


CHANGES: list[tuple[dict[str, Any], str]] = [
    (
        {"version": 1},
        "has version 1, this slipflow reads version 3: recover it with the software named in session.json",
    ),
    ({"session": "two"}, "is segment 3 of session 'two'; move it back there"),
    ({"segment": 4}, "is segment 4 of session 'one'"),
    ({"kinds": [{"batch": "Touch", "columns": []}]}, "has Touch rows with unknown columns"),
    ({"kinds": [{"batch": "Taste", "columns": []}]}, "has Taste rows with unknown columns"),
    ({"kinds": 3}, "has an invalid description"),
    ({"kinds": [[]]}, "has an invalid description"),
]


@pytest.mark.parametrize(("changes", "complaint"), CHANGES)
def test_segments_of_other_versions_are_refused(changes: dict[str, object], complaint: str) -> None:
    with pytest.raises(InputError, match=rf"^000003\.wal: {complaint}"):
        read(said(**changes))


@given(bodies=st.lists(st.binary(min_size=15, max_size=80)), raw=st.binary())
def test_any_bytes_are_a_segment_or_an_input_error(bodies: list[bytes], raw: bytes) -> None:
    for data in (raw, segment(bodies), segment([])[:16] + raw):
        with suppress(InputError):
            assert isinstance(read(data), journal_segment.Segment)
