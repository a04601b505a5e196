import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from connectors.sim.arm_motion import Controller, PlannedArm, in_base
from connectors.sim.scene import Move, Scene

PLAN = (
    Move("hold", 0.5, force=2.0),
    Move("translation", 0.9, 0.3, 45.0, 0.1),
    Move("rotation", 0.7, 0.2, speed=1.0),
    Move("translation", 0.05, 0.0, 180.0, 0.1),
    Move("lift", 0.5, force=0.0),
)
FINE = np.arange(0, 2.65, 1e-4)


def test_the_velocity_in_the_fingertip_frame_is_along_the_stroke() -> None:
    drive, local = PlannedArm(Scene(PLAN), 0).at(FINE)
    velocity, pose = in_base(drive, local)
    seen = Rotation.from_rotvec(pose[:, 3:]).apply(velocity[:, :3], inverse=True)
    np.testing.assert_allclose(seen[:, :2], drive[:, :2], atol=1e-12)
    np.testing.assert_allclose(np.diff(pose[:, :2], axis=0), velocity[:-1, :2] * 1e-4, atol=1e-6)
    cruising = drive[(FINE > 1.0) & (FINE < 1.2)]
    np.testing.assert_allclose(cruising[:, :2], 0.1 * math.sqrt(0.5), atol=1e-12)


def test_a_tap_pushes_once_along_its_direction() -> None:
    push = PlannedArm(Scene((Move("tap", 0.5, 0.2, 90.0, tap=5.0),)), 0).at(FINE)[0][:, 4:]
    assert push[:, 1].max() == pytest.approx(5.0)
    assert np.abs(push[:, 0]).max() < 1e-12
    assert push[:, 1].sum() * 1e-4 == pytest.approx(5.0 * 0.01 * 2 / 3, rel=1e-3)


def test_the_controller_keeps_its_own_time_and_reports_late() -> None:
    motion = Controller(Scene(), 0).take(1000)
    assert motion is not None
    motion.check()
    assert set(np.diff(motion.time).tolist()) == {8_000_000}
    assert motion.time[0] == 70_000_000
    assert set(np.diff(motion.device_time).tolist()) == {8_000_000}
