"""Sessions as a LeRobot dataset, read back by its documented layout alone."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from operators.batch import Labelled, Motion, ms
from operators.errors import InputError
from operators.fingertip import TAKKTILE, Fingertip, grid
from storage import Dataset, Session
from storage.exports.lerobot import export
from tests.storage.made import new_run, new_samples, record, run_sink


@dataclass
class Read:
    """A LeRobot v3.0 dataset as somebody reads it who knows its documentation only."""

    info: dict[str, Any]
    stats: dict[str, Any]
    tasks: dict[int, str]
    episodes: list[dict[str, Any]]
    frames: list[pl.DataFrame]  # of each episode

    @classmethod
    def open(cls, root: Path) -> "Read":
        """Follow info.json to the episodes and from them to the frames."""
        info = json.loads((root / "meta/info.json").read_text())
        assert info["codebase_version"] == "v3.0"
        tasks = pl.read_parquet(root / "meta/tasks.parquet")
        episodes = pl.read_parquet(root / "meta/episodes/*/*.parquet").sort("episode_index").to_dicts()
        frames = list[pl.DataFrame]()
        for episode in episodes:
            place = {name: episode[f"data/{name}"] for name in ("chunk_index", "file_index")}
            path = root / info["data_path"].format(**place)
            file = pl.read_parquet(path)
            frames.append(file.filter(pl.col("episode_index") == episode["episode_index"]))
        stats = json.loads((root / "meta/stats.json").read_text())
        return cls(info, stats, dict(zip(tasks["task_index"], tasks["task"], strict=True)), episodes, frames)

    def values(self, number: int, feature: str) -> Any:
        """The values of an episode's feature, in the shape that info.json declares."""
        column = self.frames[number][feature]
        declared = self.info["features"][feature]
        kinds = {"float32": pl.Float32(), "int64": pl.Int64(), "bool": pl.Boolean()}
        (size,), element = declared["shape"], kinds[declared["dtype"]]
        assert column.dtype == (element if size == 1 else pl.Array(element, size))
        return column.to_numpy().reshape(-1, size)

    def check(self) -> None:
        """All that the documentation promises."""
        info, index = self.info, 0
        assert set(self.frames[0].columns) == set(info["features"])
        for number, (episode, frames) in enumerate(zip(self.episodes, self.frames, strict=True)):
            assert episode["episode_index"] == number
            assert episode["dataset_from_index"] == index
            assert episode["dataset_to_index"] == index + len(frames)
            assert episode["length"] == len(frames)
            assert frames["index"].to_list() == list(range(index, index + len(frames)))
            assert frames["frame_index"].to_list() == list(range(len(frames)))
            stamps = np.arange(len(frames)) / info["fps"]
            assert np.abs(frames["timestamp"].to_numpy() - stamps).max() < 1e-4  # LeRobot's own tolerance, s
            assert {self.tasks[each] for each in frames["task_index"]} == set(episode["tasks"])
            assert frames["next.done"].to_list() == [False] * (len(frames) - 1) + [True]
            for feature in info["features"]:
                self.check_stats(
                    {key.rpartition("/")[2]: value for key, value in episode.items()
                     if key.startswith(f"stats/{feature}/")},
                    self.values(number, feature),
                )  # fmt: skip
            index += len(frames)
        assert (info["total_episodes"], info["total_frames"]) == (len(self.episodes), index)
        assert info["total_tasks"] == len(self.tasks)
        assert sorted(self.tasks) == list(range(len(self.tasks)))
        for feature in info["features"]:
            whole = np.concatenate([self.values(number, feature) for number in range(len(self.episodes))])
            self.check_stats(self.stats[feature], whole)
        ends = [tuple(map(int, span.split(":"))) for span in info["splits"].values()]
        assert [begin for begin, _ in ends] == [0, *(end for _, end in ends[:-1])]
        assert ends[-1][1] == len(self.episodes)

    @staticmethod
    def check_stats(stats: dict[str, list[float]], values: Any) -> None:
        """Statistics are those of the values."""
        values = values.astype(np.float64)
        assert stats["count"] == [len(values)]
        for name, expected in (
            ("min", values.min(axis=0)),
            ("max", values.max(axis=0)),
            ("mean", values.mean(axis=0)),
            ("std", values.std(axis=0)),
            ("q50", np.median(values, axis=0)),
        ):
            assert stats[name] == pytest.approx(expected.tolist(), rel=1e-9, abs=1e-12), name


def poses(time: Any) -> Motion:
    stamps = np.asarray(time, np.int64)
    known = stamps[:, None] / 1e9 + np.arange(6)
    return Motion.rows(stamps, stamps, 0, known)


def test_frames_have_the_values_of_the_sessions(tmp_path: Path) -> None:
    time = np.arange(60) * 10 * ms + 1_700_000_000_000_000_000
    samples = [new_samples(time), new_samples(time + 2 * ms, finger=3)]
    session = record(tmp_path, [*samples, poses(time)])
    done = export([session], tmp_path / "out")
    found = Read.open(tmp_path / "out")
    found.check()
    assert found.values(0, "observation.state").tolist() == np.hstack([s.counts for s in samples]).tolist()
    assert found.values(0, "action").tolist() == samples[0].velocity.astype(np.float32).tolist()
    assert found.values(0, "observation.pose").tolist() == poses(time).pose.astype(np.float32).tolist()
    assert found.values(0, "label").tolist() == np.stack([s.label for s in samples], axis=1).tolist()
    assert found.values(0, "valid").all()
    assert found.episodes[0]["slipflow/session"] == "one"
    assert found.episodes[0]["slipflow/start_ns"] == time[0] + 1 * ms  # the mean of both fingertips
    assert (done.episodes, done.frames, done.repeated) == (1, 60, 0)


@pytest.mark.parametrize("later", [0, 10, 12, 10_010])  # ms
def test_no_sample_is_lost_if_a_fingertip_begins_later(tmp_path: Path, later: int) -> None:
    jitter = np.random.default_rng(0).integers(-300_000, 300_000, (2, 2000))  # ns
    one, other = np.arange(2000) * 10 * ms + np.array([[0], [later * ms]]) + jitter
    session = record(tmp_path, [new_samples(one), new_samples(other, finger=1)])
    done = export([session], tmp_path / "out")
    assert (done.frames, done.repeated) == (2000 - (later + 5) // 10, 0)
    export([session], tmp_path / "half", rate=50)
    state = Read.open(tmp_path / "half").values(0, "observation.state")
    assert len(np.unique(np.diff(state, axis=0)[:-1])) == 1, "each frame skips one sample of both"


def test_a_frame_without_a_sample_repeats_the_values_before_it_and_says_so(tmp_path: Path) -> None:
    time = np.delete(np.arange(60) * 10 * ms, [20, 21, 22])
    other = new_samples(np.arange(60) * 10 * ms, finger=1)
    samples = new_samples(time)
    done = export([record(tmp_path, [samples, other])], tmp_path / "out", rate=100)
    found = Read.open(tmp_path / "out")
    found.check()
    state, valid = found.values(0, "observation.state"), found.values(0, "valid")
    assert state[19:24, :6].tolist() == samples.counts[[19, 19, 19, 19, 20]].tolist()
    assert state[:, 6:].tolist() == other.counts.tolist()
    assert valid[19:24, 0].tolist() == [True, False, False, False, True]
    assert valid[:, 6:].all()
    assert found.values(0, "label")[20:23].tolist() == [[-1, each] for each in other.label[20:23]]
    assert (done.episodes, done.frames, done.repeated) == (1, 60, 3)


def test_episodes_are_ordered_by_split(tmp_path: Path) -> None:
    sessions = list[Session]()
    for name, split in (("a", "test"), ("b", "train"), ("c", None), ("d", "validation"), ("e", "test")):
        samples = new_samples(np.arange(10) * 10 * ms)
        sessions.append(record(tmp_path, [samples], name, split))
    export(sessions, tmp_path / "out")
    found = Read.open(tmp_path / "out")
    found.check()
    assert found.info["splits"] == {"train": "0:2", "validation": "2:3", "test": "3:5"}
    assert [each["slipflow/session"] for each in found.episodes] == ["b", "c", "d", "a", "e"]


def test_motion_data_is_omitted_unless_every_session_has_it(tmp_path: Path) -> None:
    time = np.arange(10) * 10 * ms
    moving, still = new_samples(time), new_samples(time)
    moving.velocity[3], still.velocity[:] = 1e300, np.nan  # beyond float32: unknown
    sessions = [record(tmp_path, [moving, poses(time)], "a"), record(tmp_path, [still], "b")]
    assert {"action", "observation.pose"} <= set(export(sessions[:1], tmp_path / "one").features)
    done = export(sessions, tmp_path / "both")
    assert not {"action", "observation.pose"} & set(done.features)
    assert done.frames == 20
    Read.open(tmp_path / "both").check()


def test_the_rate_is_that_of_the_samples_and_a_higher_one_is_refused(tmp_path: Path) -> None:
    sessions = [
        record(tmp_path, [new_samples(np.arange(28) * period)], name)
        for name, period in (("fast", 10 * ms), ("slow", 20 * ms))
    ]
    done = export(sessions, tmp_path / "out")
    assert (done.rate, done.frames) == (50, 15 + 28)
    Read.open(tmp_path / "out").check()
    export(sessions[:1], tmp_path / "fewer", rate=20)
    fewer, samples = Read.open(tmp_path / "fewer"), new_samples(np.arange(28) * 10 * ms)
    assert fewer.values(0, "observation.state").tolist() == samples.counts[::5].tolist()
    with pytest.raises(InputError, match=r"slow: has 50 samples per second, .*; give a lower rate"):
        export(sessions, tmp_path / "other", rate=100)
    single = record(tmp_path, [new_samples([0])])
    with pytest.raises(InputError, match="one: has samples of one time only: give a rate"):
        export([single], tmp_path / "single")
    assert export([single], tmp_path / "single", rate=100).frames == 1


def test_counts_of_other_units_and_directions_are_not_mixed(tmp_path: Path) -> None:
    tips = [replace(TAKKTILE, range=span) for span in ((1023, 0), None, (0, 1023), (4095, 0))]
    for number, tip in enumerate((*tips, Fingertip(grid(6), 100.0, "kPa", 0.01))):
        run = new_run(f"s{number}")
        run.fingertips = {str(tmp_path): {Labelled: tip}}
        run_sink(Dataset(tmp_path), run, [new_samples(np.arange(10) * 10 * ms)])
    one, unknown, *others = (Session.open(tmp_path / f"sessions/s{number}") for number in range(5))
    assert export([one, unknown], tmp_path / "out[1]").episodes == 2  # also the pattern of another name
    for other in others:
        with pytest.raises(InputError, match=r"has steps of .*, range .*, but s0 has .*: export them sep"):
            export([one, other], tmp_path / "other")


def test_a_failed_export_leaves_no_files(tmp_path: Path) -> None:
    time = np.arange(10) * 10 * ms
    one = record(tmp_path / "data", [new_samples(time)], "a")
    other = record(tmp_path / "data", [new_samples(time, finger=1)], "b")
    out = tmp_path / "out"
    with pytest.raises(InputError, match=r"has fingertips \(1,\) .*, but a has .*: export them separately"):
        export([one, other], out)
    damaged = record(tmp_path / "data", [new_samples(time)], "c")
    part = next(damaged.folder.glob("samples/*.parquet"))
    part.write_bytes(part.read_bytes()[:-1])
    with pytest.raises(InputError, match="is damaged"):
        export([damaged], out)
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
