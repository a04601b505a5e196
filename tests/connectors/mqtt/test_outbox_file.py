import random
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from connectors.mqtt.outbox_file import Damaged, Entry, Epoch, OutboxFile
from operators.errors import InputError
from tests.inside import inside


def entry(number: int, epoch: str = "ab", base: int = 0) -> Entry:
    return Entry(number, epoch, number - base, "0", b'{"seq":%d}' % number, 1_000_000 + number)


def filled(path: Path, count: int = 20, sent: int = 15) -> list[Entry]:
    """A file that was closed in order; gives what is in it."""
    file, entries = OutboxFile(path), [entry(number) for number in range(1, count + 1)]
    for each in entries:
        file.append([(each, True)], [Epoch("ab", 0, each.seq, 0)])
    file.acknowledge([(1, sent)], [Epoch("ab", 0, count, sent)])
    file.close()
    return entries


def contents(file: OutboxFile, last: int = 1000) -> list[Entry]:
    return [each for epoch in file.epochs for each in file.between(epoch, 1, last, 10_000)]


def test_written_events_are_found_after_reopening(tmp_path: Path) -> None:
    entries = filled(tmp_path / "o.sqlite")
    file = OutboxFile(tmp_path / "o.sqlite")
    assert (file.highest, file.waiting, file.renewed) == (20, 5, False)
    assert file.epochs == [Epoch("ab", 0, 20, 15)]
    assert contents(file) == entries
    assert file.waiting_after(0, 3) == entries[15:18]
    assert file.waiting_after(18, 30) == entries[18:]
    assert file.between(file.epochs[0], 4, 9, 2) == entries[3:5]
    file.close()


def test_uncertain_ids_are_deleted_by_the_next_write(tmp_path: Path) -> None:
    filled(tmp_path / "o.sqlite")
    file = OutboxFile(tmp_path / "o.sqlite")
    file.append([(entry(22, "cd", 21), True)], [Epoch("ab", 0, 19, 15), Epoch("cd", 21, 1)], [20, 21])
    assert [each.id for each in file.waiting_after(0, 100)] == [16, 17, 18, 19, 22]
    file.close()


def test_only_sent_events_are_pruned_by_count_and_age(tmp_path: Path) -> None:
    filled(tmp_path / "o.sqlite")
    file = OutboxFile(tmp_path / "o.sqlite")
    file.prune(12, 0)
    assert [each.id for each in contents(file)] == list(range(9, 21))
    file.prune(12, 1_000_011)
    assert [each.id for each in contents(file)] == list(range(11, 21))
    file.prune(1, 2_000_000)
    assert [each.id for each in contents(file)] == list(range(16, 21))
    file.close()


def test_epochs_without_events_are_deleted_except_the_newest(tmp_path: Path) -> None:
    file = OutboxFile(tmp_path / "o.sqlite")
    file.append([(entry(1), False)], [Epoch("ab", 0, 1, 1), *(Epoch(f"e{n}", 1) for n in range(20))])
    file.prune(100, 0)
    file.close()
    file = OutboxFile(tmp_path / "o.sqlite")
    assert [epoch.name for epoch in file.epochs] == ["ab", *(f"e{n}" for n in range(8, 20))]
    file.close()


def abandoned(path: Path) -> tuple[list[Entry], bytes, bytes]:
    """The bytes of a file and its log as a killed process leaves them."""
    file, entries = OutboxFile(path), [entry(number) for number in range(1, 31)]
    for each in entries:
        file.append([(each, True)], [Epoch("ab", 0, each.seq, 0)])
    found = path.read_bytes(), Path(f"{path}-wal").read_bytes()
    file.close()
    return entries, *found


def survey(path: Path) -> tuple[list[Entry], bool] | None:
    """What a file gives, and whether it begins a new epoch; None if it is refused."""
    try:
        file = OutboxFile(path)
    except InputError:
        return None
    try:
        return contents(file), file.renewed
    finally:
        file.close()


def never_wrong(entries: list[Entry], found: tuple[list[Entry], bool] | None) -> bool:
    """Whether nothing is wrong, and nothing is missing without a new epoch."""
    return found is None or (set(found[0]) <= set(entries) and (found[1] or found[0] == entries))


@pytest.mark.parametrize("seed", range(6))
def test_a_flipped_bit_never_invents_an_event_or_reuses_a_number(tmp_path: Path, seed: int) -> None:
    entries = filled(tmp_path / "o.sqlite")
    content, chance = bytearray((tmp_path / "o.sqlite").read_bytes()), random.Random(seed)  # noqa: S311
    for turn in range(25):
        damaged, bit = content.copy(), chance.randrange(8 * len(content))
        damaged[bit // 8] ^= 1 << bit % 8
        path = tmp_path / f"{turn}.sqlite"
        path.write_bytes(damaged)
        assert never_wrong(entries, survey(path)), bit


@pytest.mark.parametrize("seed", range(6))
def test_a_flipped_bit_in_the_log_of_a_killed_run_reuses_no_number(tmp_path: Path, seed: int) -> None:
    entries, content, log = abandoned(tmp_path / "o.sqlite")
    chance = random.Random(seed)  # noqa: S311 - not for secrets
    assert len(log) > 30 * 4096
    for turn in range(25):
        damaged, bit = bytearray(log), chance.randrange(8 * len(log))
        damaged[bit // 8] ^= 1 << bit % 8
        path = tmp_path / f"{turn}.sqlite"
        path.write_bytes(content)
        Path(f"{path}-wal").write_bytes(damaged)
        assert never_wrong(entries, survey(path)), bit


def test_a_log_that_ends_within_a_write_loses_only_that_write(tmp_path: Path) -> None:
    entries, content, log = abandoned(tmp_path / "o.sqlite")
    for cut in (1, 4096, 4097, 3 * 4120 + 50):
        path = tmp_path / f"{cut}.sqlite"
        path.write_bytes(content)
        Path(f"{path}-wal").write_bytes(log[:-cut])
        found = survey(path)
        assert found
        assert found[0] == entries[: len(found[0])]
        assert len(found[0]) >= 30 - 1 - cut // 4120
        assert not list(tmp_path.glob("*.damaged-*"))


def in_a_payload(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content.replace(b'{"seq":17}', b'{"seq":18}'))


def no_database(path: Path) -> None:
    path.write_bytes(b"x" * 10_000)


def cut_off(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:5000])


@pytest.mark.parametrize(("damage", "kept"), [(in_a_payload, 19), (no_database, 0), (cut_off, 0)])
def test_a_damaged_file_is_renamed_and_its_intact_events_copied(
    tmp_path: Path, damage: Callable[[Path], None], kept: int, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "o.sqlite"
    entries = filled(path)
    damage(path)
    content = path.read_bytes()
    found = survey(path)
    assert found
    assert found == ([each for each in entries if each.id != 17][:kept], True)
    [aside] = tmp_path.glob("o.sqlite.damaged-*[0-9]")
    assert aside.read_bytes() == content
    waiting = 4 if kept else 0
    assert caplog.messages[0].endswith(
        f"renamed to {aside.name}; copied {kept} intact events, {waiting} of them unsent"
    )
    assert survey(path) == (found[0], False)


def test_another_kind_of_file_is_rejected_and_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "other.sqlite"
    other = sqlite3.connect(path)
    other.execute("CREATE TABLE precious (x)")
    other.close()
    content = path.read_bytes()
    with pytest.raises(InputError, match="is not an outbox: name another file"):
        OutboxFile(path)
    assert path.read_bytes() == content
    filled(tmp_path / "o.sqlite")
    later = sqlite3.connect(tmp_path / "o.sqlite")
    later.execute("PRAGMA user_version = 9")
    later.close()
    with pytest.raises(InputError, match="has outbox format 9: name another file"):
        OutboxFile(tmp_path / "o.sqlite")


def test_a_row_changed_during_a_run_is_detected_on_read(tmp_path: Path) -> None:
    filled(tmp_path / "o.sqlite")
    file = OutboxFile(tmp_path / "o.sqlite")
    inside(file, "_db").execute("UPDATE events SET payload = x'00' WHERE id = 17")
    with pytest.raises(Damaged):
        file.waiting_after(0, 100)
    file.close()
