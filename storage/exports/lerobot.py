"""Export of sessions to a LeRobot dataset, layout version 3.0, for robot learning.

.. code-block:: text

    meta/info.json                              features, rate, splits
    meta/stats.json                             statistics of each feature
    meta/tasks.parquet                          tasks by number
    meta/episodes/chunk-000/file-000.parquet    episodes: positions of their frames, statistics
    data/chunk-000/file-000.parquet             frames, one file per episode

A session becomes one episode, because slip depends on earlier samples. Its frames lie on a regular grid of
``1 / rate`` s. A frame takes the nearest sample of each fingertip within half that time; no value is
interpolated. A frame without a sample repeats the values before it, with ``valid`` false and ``label`` -1.
All frames have one task. The columns ``slipflow/session`` and ``slipflow/start_ns`` of
the episodes name their recording and the time of its first frame.

References:
    LeRobot dataset v3.0, https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

from __future__ import annotations  # they name classes of pyarrow

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from operators.batch import EVERY, UNKNOWN, Flags, Labelled, Motion, Times, concat, ms, s
from operators.errors import InputError
from operators.fingertip import RATE_TOLERANCE, Fingertip
from operators.ports import SomeBatch
from operators.score import forward_fill
from storage.arrow import pa, pq
from storage.files import partial_output, put_json
from storage.session import Session

VERSION: Final = "v3.0"
SPLITS: Final = ("train", "validation", "test")
STATE: Final = "observation.state"  # zeroed counts of all fingertips
POSE: Final = "observation.pose"  # pose of the TCP
ACTION: Final = "action"  # velocity of the TCP
DATA: Final = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
CHUNK: Final = 1000  # files per folder
POSE_WITHIN: Final = 20 * ms  # ns, largest distance between a frame and its pose

_MAX_MB: Final = 100  # where LeRobot would begin another data file
_QUANTILES: Final = (0.01, 0.1, 0.5, 0.9, 0.99)
_TASK: Final = "detect slip"

Values = dict[str, NDArray[Any]]  # one row per frame, by feature


@dataclass(frozen=True, slots=True)
class Exported:
    """Result of an export."""

    rate: int  # frames per second
    features: tuple[str, ...]
    episodes: int
    frames: int
    repeated: int  # frames without a sample of at least one fingertip
    splits: Mapping[str, str]  # range "from:to" of episodes


@dataclass(frozen=True, slots=True)
class _Contents:
    """Data that every session has."""

    fingers: tuple[int, ...]
    cells: int  # of each fingertip
    arm: frozenset[str]  # of `ACTION` and `POSE`


def export(
    sessions: Sequence[Session],
    out: Path,
    *,
    rate: int | None = None,
    progress: Callable[[int, str], object] = lambda _done, _session: None,
) -> Exported:
    """Write sessions with the same fingertips as one LeRobot dataset.

    The velocity and the pose of the arm are included if every session has them. One session, then one
    feature of all frames, is in memory.

    Args:
        sessions: Sessions to write, ordered by split and name; those without a split are for training.
        out: Folder to create.
        rate: Frames per second; None: the lowest rate of the sessions' samples, in whole Hz.
        progress: Called with the number of finished sessions and the name of the next.

    Raises:
        InputError: if a session has no samples, is damaged, or has other fingertips or units; if the rate is
            above that of the samples; if a session has no frame.
        EndpointError: if the folder exists or cannot be written; then nothing is left of it.
    """
    contents, rate = _common_contents(sessions), _frame_rate(sessions, rate)
    declared, episodes = _features(contents), list[dict[str, Any]]()
    splits, rows, repeated = list[str](), 0, 0
    with partial_output(out) as folder:
        for number, (split, session) in enumerate(_ordered(sessions)):
            progress(number, session.name)
            values, time, whole = _frames(session, rate, contents)
            values |= {
                "episode_index": np.full(len(time), number),
                "index": np.arange(rows, rows + len(time)),
                "task_index": np.zeros(len(time), np.int64),
            }
            place = {"chunk_index": number // CHUNK, "file_index": number % CHUNK}
            _write(folder / DATA.format(**place), _table(values, declared))
            stats = {f"stats/{name}": _statistics(values[name]) for name in declared}
            episodes.append(
                {
                    "episode_index": number,
                    "tasks": [_TASK],
                    "length": len(time),
                    **{f"data/{name}": value for name, value in place.items()},
                    "dataset_from_index": rows,
                    "dataset_to_index": rows + len(time),
                    **{f"{name}/{key}": value for name, of in stats.items() for key, value in of.items()},
                    "meta/episodes/chunk_index": 0,
                    "meta/episodes/file_index": 0,
                    "slipflow/session": session.name,
                    "slipflow/start_ns": int(time[0]),
                }
            )
            rows, repeated = rows + len(time), repeated + int((~whole).sum())
            splits.append(split)
        _write_task(folder)
        _write(folder / "meta/episodes/chunk-000/file-000.parquet", pa.Table.from_pylist(episodes))
        put_json(folder / "meta/stats.json", _all_statistics(folder, declared))
        begins = {split: splits.index(split) for split in splits}
        ranges = {split: f"{begin}:{begin + splits.count(split)}" for split, begin in begins.items()}
        info = {
            "codebase_version": VERSION,
            "robot_type": None,
            "total_episodes": len(episodes),
            "total_frames": rows,
            "total_tasks": 1,
            "chunks_size": CHUNK,
            "data_files_size_in_mb": _MAX_MB,
            "video_files_size_in_mb": _MAX_MB,
            "fps": rate,
            "splits": ranges,
            "data_path": DATA,
            "video_path": None,
            "features": declared,
        }
        put_json(folder / "meta/info.json", info)
    return Exported(rate, tuple(declared), len(episodes), rows, repeated, ranges)


def _common_contents(sessions: Sequence[Session]) -> _Contents:
    """Return what all sessions have."""
    found = list[_Contents]()
    for session in sessions:
        fingers = session.fingers(Labelled)
        if not fingers:
            reason = "has no samples, which frames are made of: record with `slipflow run record`"
            raise InputError(str(session.folder), reason)
        samples, motion = _rows(session, Labelled, fingers[0]), _rows(session, Motion, EVERY)
        known = {ACTION: samples.velocity, POSE: motion.pose}
        arm = frozenset(name for name, each in known.items() if _all_finite(each).any())
        found.append(_Contents(fingers, samples.cells, arm))
        own, other = (f"fingertips {each.fingers} of {each.cells} cells" for each in (found[-1], found[0]))
        if own != other:
            reason = f"has {own}, but {sessions[0].name} has {other}: export them separately"
            raise InputError(str(session.folder), reason)
    _check_scales([(each, tip) for each in sessions if (tip := each.fingertip(Labelled))])
    return replace(found[0], arm=frozenset.intersection(*(each.arm for each in found)))


def _check_scales(tips: Sequence[tuple[Session, Fingertip]]) -> None:
    """Check that the counts of all sessions have one unit, and one direction and range if these are known."""
    known = sorted(tips, key=lambda each: each[1].range is None)
    for session, tip in known:
        one, first = known[0]
        same = (tip.unit, tip.resolution) == (first.unit, first.resolution) and first.ratio(tip) == 1
        if not same or tip.falls not in {None, first.falls}:
            own, other = (f"steps of {t.resolution:g} {t.unit}, range {t.range}" for t in (tip, first))
            reason = f"has {own}, but {one.name} has {other}: export them separately"
            raise InputError(str(session.folder), reason)


def _all_finite(values: NDArray[np.floating[Any]]) -> Flags:
    """Return whether all values (n, m) of a row are finite, also as float32 (n,)."""
    return np.asarray((np.abs(values) <= np.finfo(np.float32).max).all(axis=1), np.bool_)


def _rows(session: Session, kind: type[SomeBatch], finger: int) -> SomeBatch:
    """Return all rows of a fingertip in order of time."""
    rows = concat(kind, list(session.read(kind, finger)))
    return rows[np.argsort(rows.time, kind="stable")]


def _frame_rate(sessions: Sequence[Session], wanted: int | None) -> int:
    """Return the wanted rate, or the lowest of the sessions' samples, in whole Hz."""
    rates = [(found.rate, str(each.folder)) for each in sessions if (found := each.fingertip(Labelled))]
    if wanted is None and not rates:
        raise InputError(str(sessions[0].folder), "has samples of one time only: give a rate")
    lowest, slowest = min(rates, default=(inf, ""))
    if wanted is None:
        return max(round(lowest), 1)
    if wanted > lowest * (1 + RATE_TOLERANCE):
        reason = f"has {lowest:.4g} samples per second, too few for frames at {wanted} Hz; give a lower rate"
        raise InputError(slowest, reason)
    return wanted


def _frames(session: Session, rate: int, contents: _Contents) -> tuple[Values, Times, Flags]:
    """Return the frames of a session, their times (n,) ns, and whether every fingertip has a sample (n,)."""
    samples = [_rows(session, Labelled, finger) for finger in contents.fingers]
    half, firsts = s // (2 * rate), [int(each.time[0]) for each in samples]
    latest, last = max(firsts), min(int(each.time[-1]) for each in samples)
    tip = session.fingertip(Labelled)
    interval = round(s / tip.rate) if tip else s // rate  # ns, from one sample to the next
    phases = [(first - latest + interval // 2) % interval - interval // 2 for first in firsts]
    begin = latest + sum(phases) // len(phases)  # mean time of the samples of one instant
    time = begin + np.arange(max(last - begin, 0) * rate // s + 2) * s // rate  # (n,) the grid
    near = [_nearest(each.time, time, half) for each in samples]
    hands = session.hand_labels()
    values, cells, valid, labels = Values(), list[NDArray[Any]](), list[Flags](), list[NDArray[Any]]()
    for finger, each, (row, there) in zip(contents.fingers, samples, near, strict=True):
        cells.append(forward_fill(each.counts, each.valid)[row])
        valid.append(each.valid[row] & there[:, None])
        labels.append(np.where(there, hands.replace(each.label, each.time, finger)[row], UNKNOWN))
    whole = np.logical_and.reduce([there for _, there in near])  # (n,)
    known = whole.copy()
    values[STATE] = np.concatenate(cells, axis=1).astype(np.float32)  # (n, fingers * cells)
    if POSE in contents.arm:
        motion = _rows(session, Motion, EVERY)
        motion = motion[np.flatnonzero(_all_finite(motion.pose))]
        row, there = _nearest(motion.time, time, POSE_WITHIN)
        values[POSE], known = motion.pose[row].astype(np.float32), known & there
    if ACTION in contents.arm:
        velocity = samples[0].velocity
        there = _all_finite(velocity)
        filled = forward_fill(velocity, np.repeat(there[:, None], velocity.shape[1], axis=1))
        values[ACTION], known = filled[near[0][0]].astype(np.float32), known & there[near[0][0]]
    values["valid"] = np.concatenate(valid, axis=1)
    values["label"] = np.stack(labels, axis=1).astype(np.int64)
    if not known.any():
        reason = f"has no frame at {rate} Hz with all its data; give a lower rate"
        raise InputError(str(session.folder), reason)
    span = slice(int(known.argmax()), len(known) - int(known[::-1].argmax()))  # from the first to the last
    values = {name: each[span] for name, each in values.items()}
    number = np.arange(len(time[span]))
    values |= {
        "next.done": number == len(number) - 1,
        "timestamp": (number / rate).astype(np.float32),
        "frame_index": number,
    }
    return values, time[span], whole[span]


def _nearest(known: Times, time: Times, within: int) -> tuple[NDArray[np.intp], Flags]:
    """Return the row of the nearest of `known` for each time (n,), and whether it is near (n,).

    A time without one gets the row before it.

    >>> [each.tolist() for each in _nearest(np.array([0, 10, 40]), np.array([1, 9, 20, 41]), 5)]
    [[0, 1, 1, 2], [True, True, False, True]]
    """
    after = known.searchsorted(time).clip(0, len(known) - 1)
    before = (known.searchsorted(time, "right") - 1).clip(0)
    row = np.where(time - known[before] <= known[after] - time, before, after)
    there = np.abs(known[row] - time) <= within
    return np.where(there, row, before), there


def _features(contents: _Contents) -> dict[str, dict[str, Any]]:
    """Return element type, shape and element names of each feature."""

    def feature(dtype: str, names: list[str] | None = None) -> dict[str, Any]:
        return {"dtype": dtype, "shape": [len(names or [""])], "names": names}

    fingers = [f"finger{finger}" for finger in contents.fingers]
    cells = [f"{finger}.barometer{cell}" for finger in fingers for cell in range(contents.cells)]
    found = {STATE: feature("float32", cells)}
    if POSE in contents.arm:
        found[POSE] = feature("float32", ["x", "y", "z", "rx", "ry", "rz"])
    if ACTION in contents.arm:
        found[ACTION] = feature("float32", ["vx", "vy", "vz", "wx", "wy", "wz"])
    found |= {"valid": feature("bool", cells), "label": feature("int64", fingers)}
    found |= {"next.done": feature("bool"), "timestamp": feature("float32")}
    numbers = "frame_index", "episode_index", "index", "task_index"
    return found | {name: feature("int64") for name in numbers}


def _statistics(values: NDArray[Any]) -> dict[str, list[float]]:
    """Return minimum, maximum, mean, standard deviation, quantiles and count of values (n, ...)."""
    rows = np.asarray(values, np.float64).reshape(len(values), -1)  # (n, elements)
    found: dict[str, list[float]] = {
        "min": rows.min(axis=0).tolist(),
        "max": rows.max(axis=0).tolist(),
        "mean": rows.mean(axis=0).tolist(),
        "std": rows.std(axis=0).tolist(),
        "count": [len(rows)],
    }
    for share, quantile in zip(_QUANTILES, np.quantile(rows, _QUANTILES, axis=0), strict=True):
        found[f"q{round(100 * share):02d}"] = quantile.tolist()
    return found


def _all_statistics(root: Path, declared: Iterable[str]) -> dict[str, Any]:
    """Return the statistics of each feature over all episodes; one feature at a time is in memory."""
    import polars as pl

    read = partial(pl.read_parquet, root / "data", glob=False)  # the path may contain brackets
    return {name: _statistics(read(columns=[name])[name].to_numpy()) for name in declared}


def _table(values: Values, declared: Mapping[str, Any]) -> pa.Table:
    columns: dict[str, Any] = {}
    for name in declared:
        columns[name] = pa.array(values[name].reshape(-1))
        if values[name].ndim > 1 and values[name].shape[1] > 1:
            columns[name] = pa.FixedSizeListArray.from_arrays(columns[name], values[name].shape[1])
    return pa.table(columns)


def _write_task(root: Path) -> None:
    """Write the task; the metadata makes its text the index in pandas, as LeRobot expects."""
    task = {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object"}
    pandas = {"index_columns": ["task"], "columns": [{**task, "metadata": None}], "pandas_version": "2.0.0"}
    table = pa.table({"task_index": [0], "task": [_TASK]})
    _write(root / "meta/tasks.parquet", table.replace_schema_metadata({"pandas": json.dumps(pandas)}))


def _write(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path, compression="snappy", row_group_size=max(len(table), 1))


def _ordered(sessions: Sequence[Session]) -> list[tuple[str, Session]]:
    """Return the sessions with their split, train if they have none, ordered by split and name."""
    named = [(str(each.about.get("split")), each) for each in sessions]
    known = [(split if split in SPLITS else SPLITS[0], each) for split, each in named]
    return sorted(known, key=lambda each: (SPLITS.index(each[0]), each[1].name))
