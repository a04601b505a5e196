"""Append-only log: records are stored completely or not at all, and damage is never read as a record."""

import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.errors import InputError
from storage.append_log import AppendLog, Damage, LogReader

RECORDS = [b"first", b"", b"SLIP" * 5, bytes(300)]


@pytest.fixture
def log(tmp_path: Path) -> Iterator[AppendLog]:
    made = AppendLog(tmp_path / "log", b"who")
    yield made
    made.close()


def read(path: Path) -> tuple[list[bytes], Damage | None]:
    reader = LogReader(path)
    return [record.data for record in reader.records()], reader.damage


def test_the_file_is_as_the_format_says(log: AppendLog) -> None:
    first, second = log.append([b"first", b"second!"])
    data = log.path.read_bytes()
    header = b"SLIPLOG\x01" + data[8:24] + struct.pack("<I", 3) + b"who"
    seed = zlib.crc32(header)
    expected, before = header + struct.pack("<I", seed), seed
    for record in (b"first", b"second!"):
        frame = b"SLIP" + struct.pack("<I", len(record)) + record
        position = struct.pack("<QI", len(expected), before)
        before = zlib.crc32(frame, zlib.crc32(position, seed))
        expected += frame + struct.pack("<I", before)
    assert data == expected
    assert (first, second) == (len(header) + 4, len(header) + 4 + 12 + 5)


@given(data=st.data())
def test_a_log_with_any_damage_yields_its_first_records_only(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged"
    made = AppendLog(path, b"who")
    starts = made.append(RECORDS)
    made.close()
    whole = path.read_bytes()
    place = data.draw(st.integers(0, len(whole) - 1))
    flipped = bytearray(whole)
    flipped[place] ^= data.draw(st.integers(1, 255))
    path.write_bytes(flipped)
    ends = [*starts[1:], len(whole)]
    whole_before = sum(end <= place for end in ends) if place >= starts[0] else 0
    try:
        records, damage = read(path)
    except InputError:
        assert place == 7  # its version
        return
    assert records == RECORDS[:whole_before]
    assert damage
    assert damage.offset == (starts[whole_before] if place >= starts[0] else 0)
    assert damage.offset + damage.size == len(whole)
    assert not damage.torn or place in range(damage.offset + 4, damage.offset + 8)  # a longer frame


def test_a_tail_that_a_crash_leaves_is_torn_and_any_other_is_damage(log: AppendLog) -> None:
    log.append(RECORDS)
    whole = log.path.read_bytes()
    frame = whole[log.end - 312 :]
    for tail, torn in (
        (bytes(1), True),
        (bytes(4096), True),
        (b"SLIP", True),
        (frame[:-1], True),
        (b"SLIP" * 2000, False),
        (b"x" * 5000, False),
        (frame, False),
        (bytes(4096) + frame, False),
    ):
        log.path.write_bytes(whole + tail)
        assert read(log.path) == (RECORDS, Damage(len(whole), len(tail), torn)), tail[:20]


def test_frames_of_another_log_are_not_read(log: AppendLog) -> None:
    """Blocks that a file system reuses hold whole frames of the same length."""
    places = log.append(RECORDS)
    AppendLog(log.path.with_name("other"), b"who", RECORDS).close()
    stale, whole = log.path.with_name("other").read_bytes(), log.path.read_bytes()
    assert len(stale) == len(whole)
    for number, place in enumerate(places):
        log.path.write_bytes(whole[:place] + stale[place:])
        assert read(log.path) == (RECORDS[:number], Damage(place, len(whole) - place, torn=False))


def test_another_version_a_link_and_a_pipe_are_refused_and_closed(log: AppendLog, tmp_path: Path) -> None:
    before = len([*Path("/proc/self/fd").iterdir()])
    (tmp_path / "other").write_bytes(b"SLIPLOG\x02" + bytes(100))
    (tmp_path / "link").symlink_to(log.path)
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(2**31)
    for name, reason in (
        ("other", "has log version 2; this slipflow reads version 1"),
        ("link", "is a link"),
        ("huge", "is larger than 2,047 MiB, the limit for a log"),
        ("pipe", "is not a regular file"),
    ):
        with pytest.raises(InputError, match=reason):
            LogReader(tmp_path / name)
    assert len([*Path("/proc/self/fd").iterdir()]) == before
