import os
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from operators.ports import Json
from storage import frames
from storage.episode_log import EpisodeLog
from storage.following import put_together
from storage.frames import read_segment
from storage.layout import JOURNAL, episode_log


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
