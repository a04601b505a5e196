import os
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from threading import Event
from typing import Any

import pytest

from operators.batch import Labelled, Touch, ms
from operators.ports import Json
from storage import Session, frames, recover, verify
from storage.episode_log import EpisodeLog
from storage.following import put_together
from storage.frames import read_segment
from storage.layout import JOURNAL, episode_log
from storage.writer import SessionWriter
from tests.storage.made import new_batch, new_run


def told(folder: Path) -> list[Any]:
    segment = read_segment(episode_log(folder).read_bytes(), "", "one", frames.EPISODE_LOG)
    assert segment.damage is None
    found: Any = put_together(segment.changes, "").get("rig", {"episodes": []})["episodes"]
    return [*found]


@pytest.fixture
def listed() -> list[Json]:
    return [{"start": 0, "end": 5}]


@pytest.fixture
def log(tmp_path: Path, listed: list[Json]) -> Iterator[EpisodeLog]:
    (tmp_path / JOURNAL).mkdir()
    made = EpisodeLog(tmp_path, "one", {"rig": {"episodes": listed}})
    yield made
    made.close()


def test_it_tells_of_what_was_kept(log: EpisodeLog, tmp_path: Path, listed: list[Json]) -> None:
    assert told(tmp_path) == []
    log.keep()
    assert told(tmp_path) == listed
    listed.append({"start": 5, "end": 9})
    log.keep()
    assert told(tmp_path) == listed


def test_an_episode_costs_the_same_however_many_came_before(
    log: EpisodeLog, tmp_path: Path, listed: list[Json]
) -> None:
    sizes = list[int]()
    for start in range(5, 1000):
        listed.append({"start": start, "end": start + 1})
        log.keep()
        sizes.append(episode_log(tmp_path).stat().st_size)
    assert max(after - before for before, after in pairwise(sizes)) < 150


def test_where_nothing_is_new_nothing_is_written(
    log: EpisodeLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log.keep()
    before, synced = episode_log(tmp_path).read_bytes(), list[int]()
    monkeypatch.setattr(os, "fsync", synced.append)
    log.keep()
    assert (episode_log(tmp_path).read_bytes(), synced) == (before, [])


def test_what_the_disk_refused_is_told_at_the_next_try(
    log: EpisodeLog, tmp_path: Path, listed: list[Json], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full)
        with pytest.raises(OSError, match="No space left"):
            log.keep()
    log.keep()
    assert told(tmp_path) == listed


def test_after_an_fsync_that_failed_all_is_told_in_another_file(
    log: EpisodeLog, tmp_path: Path, listed: list[Json], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: int) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fail)
        for _ in range(2):
            with pytest.raises(OSError, match="Input/output"):
                log.keep()
    before = episode_log(tmp_path).stat().st_ino
    listed.append({"start": 5, "end": 9})
    log.keep()
    assert told(tmp_path) == listed
    assert episode_log(tmp_path).stat().st_ino != before
    listed.append({"start": 9, "end": 10})
    log.keep()
    assert told(tmp_path) == listed


@pytest.mark.parametrize("wrong", [[{"start": {1}}], 3])
def test_what_cannot_be_told_waits_and_costs_nothing_that_was(
    tmp_path: Path, listed: list[Json], wrong: object
) -> None:
    (tmp_path / JOURNAL).mkdir()
    describe: dict[str, Any] = {"rig": {"episodes": listed}}
    log = EpisodeLog(tmp_path, "one", describe)
    log.keep()
    describe["rig"] = {"episodes": wrong}
    log.keep()
    assert told(tmp_path) == listed
    log.close()


def episodes(*starts: int) -> list[Json]:
    return [{"start": start * ms, "end": (start + 10) * ms, "motion": "tap"} for start in starts]


def starts(folder: Path) -> list[int]:
    return [start // ms for start in Session.open(folder).frame("episodes")["start"].to_list()]


def test_samples_get_the_episodes_that_were_told_while_it_ran(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told, noted = list[Json](), Event()

    def reach(step: str) -> None:
        if step == "sync frames" and told:
            noted.set()

    monkeypatch.setattr("storage.journal.SYNC", 0.001)
    monkeypatch.setattr("storage.steps.reach", reach)
    writer = SessionWriter(tmp_path, new_run(describe={"rig": {"episodes": told}}), 10**12, 1000)
    writer.add(new_batch(Labelled, 5))
    told.append({"start": 0, "end": 20 * ms, "motion": "hold"})
    assert noted.wait(60)  # the journal has looked since
    folder = writer.folder
    del writer
    session = Session.open(folder)
    assert session.frame("episodes")["motion"].to_list() == ["hold"]
    assert session.frame("samples")["episode"].to_list() == [0, 0, -1, -1, -1]


def test_a_file_of_episodes_that_was_just_being_replaced_costs_none(tmp_path: Path) -> None:
    told = episodes(0)
    writer: Any = SessionWriter(tmp_path, new_run(describe={"rig": {"episodes": told}}), 10**12, 1000)
    told += episodes(10, 20)
    writer._journal.keep_episodes()
    writer._commit_episodes(final=True)  # and is killed before the manifest
    del writer
    folder = tmp_path / "sessions/one"
    assert recover(folder).complete
    assert starts(folder) == [0, 10, 20]
    assert verify(tmp_path).worst == "lossy"  # it was never closed


def test_a_source_that_began_anew_is_believed(tmp_path: Path) -> None:
    told = episodes(0, 10, 20)
    writer: Any = SessionWriter(tmp_path, new_run(describe={"rig": {"episodes": told}}), 10**12, 1000)
    writer._journal.keep_episodes()
    told[:] = episodes(40)
    del writer
    assert starts(tmp_path / "sessions/one") == [40]


@pytest.mark.parametrize(
    ("frame", "weight", "left_over"),
    [(0, "lost", [0]), (1, "lost", [0]), (2, "lost", [0, 10]), (3, "lossy", [0, 10, 20])],
)
def test_damage_to_what_the_journal_tells_of_episodes_costs_those_behind_it_and_no_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, frame: int, weight: str, left_over: list[int]
) -> None:
    monkeypatch.setattr("storage.journal.SYNC", 3600.0)
    told = episodes(0)
    writer: Any = SessionWriter(tmp_path, new_run(describe={"rig": {"episodes": told}}), 10**12, 1000)
    writer.append(new_batch(Labelled))
    for start in (10, 20, 30):
        told += episodes(start)
        writer._journal.keep_episodes()
    folder, path = writer.folder, episode_log(writer.folder)
    del writer
    data = bytearray(path.read_bytes())
    places = [match.start() for match in re.finditer(b"SLIP", data)][1:]  # the file begins so, too
    assert len(places) == 4
    data[places[frame] + 20] ^= 1
    path.write_bytes(data)
    assert verify(folder).worst == weight
    done = recover(folder)
    assert done.rows == {"samples": 5}
    assert "episodes.wal: its last" in done.lost[0]
    assert starts(folder) == left_over
    assert (folder / "damaged/journal-episodes.wal").exists() == (weight == "lost")


def test_episodes_that_cannot_be_cost_no_row(tmp_path: Path) -> None:
    told = list[Json]()
    writer: Any = SessionWriter(tmp_path, new_run(describe={"rig": {"episodes": told}}), 10**12, 1000)
    told += [{"start": 0, "end": 20 * ms}, {"start": 10 * ms, "end": 30 * ms}]  # they overlap
    writer.append(new_batch(Touch, 1))
    writer._leave()  # tells at last
    recovery = recover(writer.folder)
    assert recovery.rows == {"touch": 1}
    assert [each.partition(":")[0] for each in recovery.lost] == ["episodes"]
