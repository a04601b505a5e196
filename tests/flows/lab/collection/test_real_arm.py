"""A collection with the real drivers, an emulated controller that ur-rtde commands, and an emulated bus."""

import asyncio
import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flows.cli.collect import _collect
from flows.lab.collection.stroke_plan import Limits
from flows.run.clocks import LoopClock
from operators import EVERY, SLIP, Labelled, Motion, Touch, concat
from operators.batch import Counts
from storage import Session
from tests.emulators.i2c_bus import EmulatedI2cBus, served
from tests.emulators.ur_controller import CB3, UrController
from tests.emulators.ur_program import Drive
from tests.flows.lab.collection.test_collector import QUICK, STROKES
from tests.loopback import own_host
from tests.waiting import PATIENCE

HOST = own_host(3)
PATH = "/dev/i2c-33"
TOUCHING = np.array([0.4, 0.0, 0.0, np.pi, 0.0, 0.0])


class Skin:
    """Counts that fall with the force of the surface on an arm."""

    def __init__(self, arm: Drive) -> None:
        self._arm = arm

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        return np.full(6, round(450 - 40 * self._arm.push), np.int16), np.full(6, 507, np.int16)


@pytest.mark.skipif(importlib.util.find_spec("rtde_control") is None, reason="needs the extra `ur`")
async def test_a_real_arm_is_driven_and_recorded(tmp_path: Path) -> None:
    limits = Limits(margin=0.05, sensor_timeout=5.0, watchdog=0.1)  # for a busy host
    plan = replace(QUICK, limits=limits)
    controller = UrController(TOUCHING, host=HOST, version=CB3, now=LoopClock().now)
    with served(EmulatedI2cBus(Skin(controller.box.drive)), PATH):
        async with asyncio.timeout(PATIENCE), controller:
            collected = await _collect(plan, HOST, PATH, (0,), tmp_path)
    assert (collected.strokes, collected.error) == (STROKES, "")
    session = Session.open(tmp_path / "sessions" / collected.summaries[0].session)
    assert concat(Touch, list(session.read(Touch, 0))).valid.all()
    motion = concat(Motion, list(session.read(Motion, EVERY)))
    assert (np.rint(np.diff(motion.device_time) / 8e6) == 1).all()  # every package once
    labels = concat(Labelled, list(session.read(Labelled, 0))).label
    sliding = np.hypot(*motion.velocity[:, :2].T) > 0.003  # m/s
    assert (labels == SLIP).mean() == pytest.approx(sliding.mean(), rel=0.5)  # a busy host scans less often
