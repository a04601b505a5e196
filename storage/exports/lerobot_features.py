"""Features of a LeRobot dataset: their declarations in info.json, and the values of each frame."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from operators.batch import MOTIONS, Episodes
from storage.exports.grid import Contents, Frames

STATE: Final = "observation.state"  # zeroed counts of all fingertips
POSE: Final = "observation.pose"  # pose of the TCP
ACTION: Final = "action"  # velocity of the TCP
VALID: Final = "valid"  # barometers with a reading; else the state keeps the last value
LABEL: Final = "label"  # 1 slip, 0 static, -1 unknown
DONE: Final = "next.done"

_TASKS: Final[Mapping[str | None, str]] = {
    "translation": "slide the fingertip over the surface",
    "rotation": "turn the fingertip on the surface",
    "hold": "hold the fingertip still",
    "tap": "tap the surface",
    "lift": "lift the fingertip off",
}
_OTHER_TASK: Final = "detect slip"


def features(contents: Contents) -> dict[str, dict[str, Any]]:
    """Return element type, shape and element names of each feature.

    >>> features(Contents((0,), 6, velocity=True, pose=False))["action"]
    {'dtype': 'float32', 'shape': [6], 'names': ['vx', 'vy', 'vz', 'wx', 'wy', 'wz']}
    """
    cells = [
        f"finger{finger}.barometer{cell}" for finger in contents.fingers for cell in range(contents.cells)
    ]
    found = {STATE: _feature("float32", cells)}
    if contents.pose:
        found[POSE] = _feature("float32", ["x", "y", "z", "rx", "ry", "rz"])
    if contents.velocity:
        found[ACTION] = _feature("float32", ["vx", "vy", "vz", "wx", "wy", "wz"])
    found[VALID] = _feature("bool", cells)
    found[LABEL] = _feature("int64", [f"finger{finger}" for finger in contents.fingers])
    found[DONE] = _feature("bool")
    found["timestamp"] = _feature("float32")
    for name in ("frame_index", "episode_index", "index", "task_index"):
        found[name] = _feature("int64")
    return found


def values(
    frames: Frames, contents: Contents, rate: int, *, episode: int, index: int, tasks: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    """Return the values of each feature, one row per frame.

    Args:
        frames: Frames of one episode.
        contents: Data that every session of the dataset has.
        rate: Frames per second.
        episode: Number of the episode.
        index: Index of its first frame in the dataset.
        tasks: (n,) task numbers of the frames.
    """
    number = np.arange(len(frames))
    found: dict[str, NDArray[Any]] = {STATE: frames.counts.astype(np.float32)}  # (n, fingers * cells)
    if contents.pose:
        found[POSE] = frames.pose
    if contents.velocity:
        found[ACTION] = frames.velocity
    found[VALID] = frames.valid
    found[LABEL] = frames.label.astype(np.int64)
    found[DONE] = number == len(frames) - 1
    found["timestamp"] = (number / rate).astype(np.float32)
    found["frame_index"] = number
    found["episode_index"] = np.full(len(frames), episode)
    found["index"] = number + index
    found["task_index"] = tasks
    return found


def frame_tasks(frames: Frames, episodes: Episodes) -> list[str]:
    """Return the task of each frame (n,), from the motions of the recording's episodes."""
    codes: list[int] = episodes.motion.tolist()
    tasks = [*(_TASKS.get(MOTIONS[code], _OTHER_TASK) for code in codes), _OTHER_TASK]
    ends = np.append(episodes.end, np.iinfo(np.int64).min)
    number = episodes.time.searchsorted(frames.time, "right") - 1  # (n,) -1: before the first
    number = np.where(frames.time < ends[number], number, -1)
    return [tasks[each] for each in number.tolist()]


def _feature(dtype: str, names: list[str] | None = None) -> dict[str, Any]:
    return {"dtype": dtype, "shape": [len(names or [""])], "names": names}
