"""What a frame of a LeRobot dataset holds: the features that info.json declares, and their values."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from operators.batch import BAROMETERS, MOTIONS, Episodes
from storage.exports.grid import Frames, Holdings

STATE: Final = "observation.state"  # zeroed counts of all fingertips
POSE: Final = "observation.pose"  # of the TCP
ACTION: Final = "action"  # the TCP's velocity at the frame
VALID: Final = "valid"  # which barometers answered; where one did not, the state keeps what it read last
LABEL: Final = "label"  # 1 slip, 0 static, -1 unknown
DONE: Final = "next.done"

_DOING: Final[Mapping[str | None, str]] = {
    "translation": "slide the fingertip over the surface",
    "rotation": "turn the fingertip on the surface",
    "hold": "hold the fingertip still",
    "tap": "tap the surface",
    "lift": "lift the fingertip off",
}
_OTHERWISE: Final = "feel slip"


def features(held: Holdings) -> dict[str, dict[str, Any]]:
    """The features by name, each with its element type, its shape and the names of its elements.

    >>> features(Holdings((0,), velocity=True, pose=False))["action"]
    {'dtype': 'float32', 'shape': [6], 'names': ['vx', 'vy', 'vz', 'wx', 'wy', 'wz']}
    """
    cells = [f"finger{finger}.barometer{cell}" for finger in held.fingers for cell in range(BAROMETERS)]
    found = {STATE: _feature("float32", cells)}
    if held.pose:
        found[POSE] = _feature("float32", ["x", "y", "z", "rx", "ry", "rz"])
    if held.velocity:
        found[ACTION] = _feature("float32", ["vx", "vy", "vz", "wx", "wy", "wz"])
    found[VALID] = _feature("bool", cells)
    found[LABEL] = _feature("int64", [f"finger{finger}" for finger in held.fingers])
    found[DONE] = _feature("bool")
    found["timestamp"] = _feature("float32")
    for name in ("frame_index", "episode_index", "index", "task_index"):
        found[name] = _feature("int64")
    return found


def values(
    frames: Frames, held: Holdings, rate: int, *, episode: int, index: int, tasks: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    """The values of each feature, a row to a frame.

    Args:
        frames: One episode.
        held: What the dataset has of every session.
        rate: Frames per second.
        episode: Number of the episode.
        index: Of its first frame, in the dataset.
        tasks: (n,) numbers of the frames' tasks.
    """
    number = np.arange(len(frames))
    found: dict[str, NDArray[Any]] = {STATE: frames.counts.astype(np.float32)}  # (n, fingers * 6)
    if held.pose:
        found[POSE] = frames.pose
    if held.velocity:
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


def doing(frames: Frames, episodes: Episodes) -> list[str]:
    """What the arm does at each frame, in words, as the recording's episodes say of its motion; (n,)."""
    words = [*(_DOING.get(MOTIONS[code], _OTHERWISE) for code in episodes.motion.tolist()), _OTHERWISE]
    ends = np.append(episodes.end, np.iinfo(np.int64).min)
    number = episodes.time.searchsorted(frames.time, "right") - 1  # (n,) -1: before the first
    number = np.where(frames.time < ends[number], number, -1)
    return [words[each] for each in number.tolist()]


def _feature(dtype: str, names: list[str] | None = None) -> dict[str, Any]:
    return {"dtype": dtype, "shape": [len(names or [""])], "names": names}
