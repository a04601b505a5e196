"""Export of sessions to a LeRobot dataset, layout version 3.0, for robot learning.

.. code-block:: text

    meta/info.json                              features, rate, splits
    meta/stats.json                             statistics of each feature
    meta/tasks.parquet                          tasks by number
    meta/episodes/chunk-000/file-000.parquet    episodes: positions of their frames, statistics
    data/chunk-000/file-000.parquet             frames
    slipflow/                                   on request: the sessions, unchanged, as a dataset of slipflow

A session becomes one episode, because it goes from rest to rest and slip depends on earlier samples.
The motion of the arm is the task of each frame. Missing samples split the session, see
`storage.exports.grid`. Frames are ``1 / rate`` s apart, counted from the start of their episode. The columns
``slipflow/session`` and ``slipflow/start_ns`` of the episodes name their recording and its time.

References:
    LeRobot dataset v3.0, https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isclose
from pathlib import Path
from shutil import copy2, copytree
from typing import Any, Final

import numpy as np

from operators.batch import EVERY, Episodes, Labelled, concat
from operators.checks import check_at_least
from operators.errors import EndpointError, InputError, ParameterError, os_error_reason
from operators.fingertip import RATE_TOLERANCE
from storage.description import describe_dataset
from storage.exports.grid import Contents, find_contents, to_frames
from storage.exports.lerobot_features import features, frame_tasks, values
from storage.exports.lerobot_files import (
    CHUNK,
    DATA,
    MAX_MB,
    DataFiles,
    statistics,
    write_episodes,
    write_tasks,
)
from storage.files import partial_folder, put_json
from storage.layout import JOURNAL, may_exist, session_folder
from storage.session import Session

VERSION: Final = "v3.0"
SPLITS: Final = ("train", "validation", "test")
NATIVE: Final = "slipflow"  # folder of the copied sessions
_MEASURED: Final = 1e-3  # largest relative error of a measured rate


@dataclass(frozen=True, slots=True)
class Exported:
    """Result of an export."""

    out: Path
    rate: int  # frames per second
    features: tuple[str, ...]
    sessions: int
    episodes: int
    frames: int
    samples: int  # of the first fingertip of each session
    gaps: int  # that split sessions
    splits: Mapping[str, str]  # range "from:to" of episodes


def export(
    sessions: Sequence[Session],
    out: Path,
    *,
    rate: int | None = None,
    task: str | None = None,
    native: bool = False,
    progress: Callable[[int, str], object] = lambda _done, _session: None,
) -> Exported:
    """Write sessions with the same fingertips as one LeRobot dataset.

    The velocity and the pose of the arm are included if every session has them. One session, then one
    feature of all frames, is in memory.

    Args:
        sessions: Sessions to write, ordered by split and name; those without a split are for training.
        out: Folder to create.
        rate: Frames per second; None: the lowest rate of the sessions' samples, in whole Hz.
        task: Task description; None: the motion of the arm in the recording's episodes.
        native: Also copy the sessions, with all rows at their own rate, into the folder ``slipflow``.
        progress: Called with the number of finished sessions and the name of the next.

    Raises:
        ParameterError: if the rate is below 1 Hz, or there is no session.
        InputError: if a session has no samples, is damaged, or has other fingertips; if the rate is above
            that of the samples; if there is no frame; if a session to copy is being recorded.
        EndpointError: if the folder exists or cannot be written; then nothing is left of it.
    """
    if rate is not None:
        check_at_least("LeRobot export", "rate", rate, 1, "Hz")
    contents = _common_contents(sessions)
    rate = _frame_rate(sessions, rate)
    declared = features(contents)
    tasks, splits, episodes = dict[str, int](), Counter[str](), list[dict[str, Any]]()
    samples, gaps = 0, 0
    with partial_folder(out) as folder, DataFiles(folder, declared) as data:
        for done, (split, session) in enumerate(_ordered(sessions)):
            progress(done, session.name)
            grid = to_frames(session, rate, contents)
            samples, gaps = samples + grid.samples, gaps + max(len(grid.stretches) - 1, 0)
            recorded = concat(Episodes, list(session.read(Episodes, EVERY)))
            for stretch in grid.stretches:
                words = frame_tasks(stretch, recorded) if task is None else [task] * len(stretch)
                numbers = np.array([tasks.setdefault(each, len(tasks)) for each in words])
                first, number = data.rows, len(episodes)
                rows = values(stretch, contents, rate, episode=number, index=first, tasks=numbers)
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
            if native:
                _copy(session, folder / NATIVE)
        data.close()
        if not episodes:
            reason = f"would have no frames: no two samples are consecutive at {rate} Hz; give a lower rate"
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


def _copy(session: Session, root: Path) -> None:
    """Copy a session into a dataset, file by file.

    Raises:
        InputError: if it is being recorded.
    """
    if may_exist(session.folder / JOURNAL):
        raise InputError(str(session.folder), "is being recorded: export it when the recording ends")
    root.mkdir(exist_ok=True)
    describe_dataset(root)
    copytree(session.folder, session_folder(root, session.name), copy_function=_copy_file)


def _copy_file(source: str, target: str) -> None:
    """Copy a file; raise at once, where `copytree` would go on and collect the errors of all files."""
    try:
        copy2(source, target)
    except OSError as error:
        raise EndpointError(target, f"cannot be written: {os_error_reason(error)}") from error


def _common_contents(sessions: Sequence[Session]) -> Contents:
    """Return the data that every session has."""
    if not sessions:
        raise ParameterError("LeRobot export", "sessions", [], "at least one")
    found = [find_contents(session) for session in sessions]
    for session, each in zip(sessions, found, strict=True):
        if (each.fingers, each.cells) != (found[0].fingers, found[0].cells):
            own, other = (f"fingertips {one.fingers} of {one.cells} cells" for one in (each, found[0]))
            reason = f"has {own}, but {sessions[0].name} has {other}"
            raise InputError(str(session.folder), f"{reason}: export them separately")
    velocity, pose = (
        all(known) for known in zip(*((each.velocity, each.pose) for each in found), strict=True)
    )
    return Contents(found[0].fingers, found[0].cells, velocity, pose)


def _frame_rate(sessions: Sequence[Session], wanted: int | None) -> int:
    """Return the wanted rate, or the lowest of the sessions' samples: whole, rounded down unless measured.

    Raises:
        InputError: if the wanted rate is above that of a session's samples, so that few are consecutive.
    """
    rates = [(found.rate, str(each.folder)) for each in sessions if (found := each.fingertip(Labelled))]
    lowest, slowest = min(rates)
    if wanted is None:
        nearest = round(lowest)
        return max(nearest if isclose(nearest, lowest, rel_tol=_MEASURED) else int(lowest), 1)
    if wanted > lowest * (1 + RATE_TOLERANCE):
        reason = f"has {lowest:.4g} samples per second, too few for frames at {wanted} Hz; give a lower rate"
        raise InputError(slowest, reason)
    return wanted


def _ordered(sessions: Sequence[Session]) -> list[tuple[str, Session]]:
    """Return the sessions with their split, ordered by split and name."""
    return sorted(
        ((_split(each), each) for each in sessions), key=lambda each: (SPLITS.index(each[0]), each[1].name)
    )


def _split(session: Session) -> str:
    split = session.about.get("split")
    return split if isinstance(split, str) and split in SPLITS else SPLITS[0]


def _ranges(splits: Mapping[str, int]) -> dict[str, str]:
    """Return the episode range of each split.

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
