"""Contents of a frame of a LeRobot dataset."""

from typing import Any

import numpy as np
import pytest

from operators.batch import Episodes, s
from storage.exports.grid import Contents, Frames
from storage.exports.lerobot_features import features, frame_tasks, values
from tests.storage.made import new_episodes


def some(count: int, fingers: int = 1) -> Frames:
    wide = np.arange(count * 6, dtype=np.float32).reshape(count, 6)
    counts = np.arange(count * 6 * fingers, dtype=np.int16).reshape(count, -1)
    label = np.full((count, fingers), -1, np.int8)
    return Frames(np.arange(count) * s, counts, counts > 0, label, wide, -wide)


@pytest.mark.parametrize("velocity", [False, True])
@pytest.mark.parametrize("pose", [False, True])
@pytest.mark.parametrize("fingers", [(0,), (0, 2)])
def test_values_match_the_declared_features(*, velocity: bool, pose: bool, fingers: tuple[int, ...]) -> None:
    contents, frames = Contents(fingers, 6, velocity=velocity, pose=pose), some(5, len(fingers))
    declared = features(contents)
    found = values(frames, contents, 50, episode=3, index=100, tasks=np.zeros(5, np.int64))
    assert list(found) == list(declared)
    for name, feature in declared.items():
        assert found[name].dtype == feature["dtype"], name
        assert found[name].size == 5 * feature["shape"][0], name
        assert feature["names"] is None or len(feature["names"]) == feature["shape"][0]
    assert ("action" in found, "observation.pose" in found) == (velocity, pose)
    assert found["timestamp"].tolist() == np.array([0, 0.02, 0.04, 0.06, 0.08], np.float32).tolist()
    assert found["index"].tolist() == [100, 101, 102, 103, 104]
    assert found["next.done"].tolist() == [False] * 4 + [True]


def test_elements_are_named_by_fingertip_and_barometer() -> None:
    names: Any = features(Contents((0, 2), 6, velocity=True, pose=False))["observation.state"]["names"]
    assert names[:2] == ["finger0.barometer0", "finger0.barometer1"]
    assert names[-1] == "finger2.barometer5"


def test_the_task_is_the_motion_at_the_frame() -> None:
    episodes = new_episodes((s, 2 * s, "translation"), (2 * s, 3 * s, "rotation"))
    slides, turns, otherwise = (
        "slide the fingertip over the surface",
        "turn the fingertip on the surface",
        "detect slip",
    )
    assert frame_tasks(some(5), episodes) == [otherwise, slides, turns, otherwise, otherwise]
    assert frame_tasks(some(2), Episodes.empty()) == [otherwise] * 2
