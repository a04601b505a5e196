"""Sessions as a LeRobot dataset, version 3.0 of its layout, for robot learning.

.. code-block:: text

    meta/info.json                              what there is: features, rate, splits
    meta/stats.json                             statistics of each feature
    meta/tasks.parquet                          the tasks by number
    meta/episodes/chunk-000/file-000.parquet    the episodes: where their frames are, their statistics
    data/chunk-000/file-000.parquet             the frames

A session becomes one episode, since it goes from rest to rest and slip is told by what came before; what the
arm does meanwhile is the task of each frame. Where samples are missing the session is cut, see
`storage.exports.grid`. Frames are ``1 / rate`` apart, counted from the begin of their episode; the columns
``slipflow/session`` and ``slipflow/start_ns`` of the episodes say which recording they are of, and when.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from operators.batch import EVERY, Episodes, concat
from operators.errors import InputError, ParameterError
from storage.exports.grid import Holdings, frames, holdings
from storage.exports.lerobot_features import doing, features, values
from storage.exports.lerobot_files import (
    CHUNK,
    DATA,
    MAX_MB,
    DataFiles,
    statistics,
    write_episodes,
    write_tasks,
)
from storage.files import put_json
from storage.partial import partial_folder
from storage.session import Session

VERSION: Final = "v3.0"
SPLITS: Final = ("train", "validation", "test")


@dataclass(frozen=True, slots=True)
class Exported:
    """What came of it."""

    out: Path
    rate: int  # frames per second
    features: tuple[str, ...]
    sessions: int
    episodes: int
    frames: int
    samples: int  # of the first fingertips, which the frames were taken from
    gaps: int  # that a session was cut at
    splits: Mapping[str, str]  # "from:to", of the episodes


def export(
    sessions: Sequence[Session],
    out: Path,
    *,
    rate: int = 100,
    task: str | None = None,
    progress: Callable[[int, str], object] = lambda _done, _session: None,
) -> Exported:
    """Write sessions of the same fingertips as one LeRobot dataset.

    The velocity and the pose of the arm are in it if every session has them. One session at a time is in
    memory.

    Args:
        sessions: What to write, ordered by split and name; those without a split are for training.
        out: The folder, which must not be there.
        rate: Frames per second.
        task: What the arm does, in words; None: what the recordings' episodes say of its motion.
        progress: Told how many sessions are done, and the name of the next.

    Raises:
        ParameterError: on a rate below 1.
        InputError: if a session holds no samples, is damaged, or has other fingertips; if there is no frame.
        EndpointError: if the folder is there already, or cannot be written; nothing is left then.
    """
    if rate < 1:
        raise ParameterError("LeRobot export", "rate", rate, "at least 1 Hz")
    held = _common(sessions)
    declared = features(held)
    tasks, splits, episodes = dict[str, int](), Counter[str](), list[dict[str, Any]]()
    samples, gaps = 0, 0
    with partial_folder(out) as folder, DataFiles(folder, declared) as data:
        for done, (split, session) in enumerate(_ordered(sessions)):
            progress(done, session.name)
            cut = frames(session, rate, held)
            samples, gaps = samples + cut.samples, gaps + max(len(cut.stretches) - 1, 0)
            episodes_of = concat(Episodes, list(session.read(Episodes, EVERY)))
            for stretch in cut.stretches:
                words = doing(stretch, episodes_of) if task is None else [task] * len(stretch)
                numbers = np.array([tasks.setdefault(each, len(tasks)) for each in words])
                first, number = data.rows, len(episodes)
                rows = values(stretch, held, rate, episode=number, index=first, tasks=numbers)
                chunk, file = data.write(rows)
                episodes.append(
                    {
                        "episode_index": number,
                        "tasks": list(dict.fromkeys(words)),
                        "length": len(stretch),
                        "data/chunk_index": chunk,
                        "data/file_index": file,
                        "dataset_from_index": first,
                        "dataset_to_index": data.rows,
                        **_flat({name: statistics(each) for name, each in rows.items()}),
                        "meta/episodes/chunk_index": 0,
                        "meta/episodes/file_index": 0,
                        "slipflow/session": session.name,
                        "slipflow/start_ns": int(stretch.time[0]),
                    }
                )
                splits[split] += 1
        data.close()
        if not episodes:
            reason = f"would hold no frames: no two samples follow each other at {rate} Hz; give a lower rate"
            raise InputError(str(out), reason)
        write_tasks(folder, list(tasks))
        write_episodes(folder, episodes)
        put_json(folder / "meta/stats.json", data.statistics())
        ranges = _ranges(splits)
        put_json(
            folder / "meta/info.json",
            {
                "codebase_version": VERSION,
                "robot_type": None,
                "total_episodes": len(episodes),
                "total_frames": data.rows,
                "total_tasks": len(tasks),
                "chunks_size": CHUNK,
                "data_files_size_in_mb": MAX_MB,
                "video_files_size_in_mb": MAX_MB,
                "fps": rate,
                "splits": ranges,
                "data_path": DATA,
                "video_path": None,
                "features": declared,
            },
        )
    count = len(sessions), len(episodes), data.rows, samples, gaps
    return Exported(out, rate, tuple(declared), *count, ranges)


def _common(sessions: Sequence[Session]) -> Holdings:
    """What every session holds."""
    if not sessions:
        raise ParameterError("LeRobot export", "sessions", [], "at least one")
    held = [holdings(session) for session in sessions]
    for session, each in zip(sessions, held, strict=True):
        if each.fingers != held[0].fingers:
            reason = f"is of fingertips {each.fingers}, {sessions[0].name} of {held[0].fingers}"
            raise InputError(str(session.folder), f"{reason}; export them apart")
    return Holdings(held[0].fingers, all(each.velocity for each in held), all(each.pose for each in held))


def _ordered(sessions: Sequence[Session]) -> list[tuple[str, Session]]:
    """The sessions with their split, those of one split together."""
    return sorted(
        ((_split(each), each) for each in sessions), key=lambda each: (SPLITS.index(each[0]), each[1].name)
    )


def _split(session: Session) -> str:
    split = session.about.get("split")
    return split if isinstance(split, str) and split in SPLITS else SPLITS[0]


def _ranges(splits: Mapping[str, int]) -> dict[str, str]:
    """Where the episodes of each split are.

    >>> _ranges({"train": 7, "test": 2})
    {'train': '0:7', 'test': '7:9'}
    """
    ranges, begin = dict[str, str](), 0
    for split in SPLITS:
        if count := splits.get(split, 0):
            ranges[split] = f"{begin}:{begin + count}"
            begin += count
    return ranges


def _flat(found: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {f"stats/{name}/{each}": value for name, all_ in found.items() for each, value in all_.items()}
