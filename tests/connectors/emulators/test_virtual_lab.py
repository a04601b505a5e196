import asyncio
import socket
import time
from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import cast

import numpy as np
import pytest
from pymodbus.client import AsyncModbusTcpClient

from connectors import TakkTile, UrMotion
from connectors.emulators.lab_loop import run_lab
from connectors.emulators.shared_scene import SharedScene
from connectors.emulators.ur_controller import Ports
from connectors.emulators.virtual_lab import HEIGHT, virtual_lab
from connectors.sim.scene import commanded_scene
from flows.run.clocks import LoopClock
from operators import EndpointError, Touch, Truth
from operators.batch import Counts, Reals, s
from tests.connectors.emulators.observed_scene import ObservedScene
from tests.waiting import PATIENCE

ANYWHERE = Ports(0, 0, 0)


def test_the_arm_that_is_commanded_drags_and_presses_the_fingertip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("connectors.emulators.virtual_lab.SharedScene", ObservedScene)

    async def main() -> None:
        clock = LoopClock()
        async with virtual_lab(ports=ANYWHERE) as lab:
            touch, motion = TakkTile(lab.bus), UrMotion("127.0.0.1", port=lab.controller.ports.rtde)

            async def counts() -> Counts:
                async with aclosing(cast("AsyncGenerator[Touch]", touch.batches(clock))) as batches:
                    found: Counts = (await anext(batches)).counts[0]
                    return found

            in_air = await counts()
            lab.controller.box.drive.line(np.array([0.0, 0.0, -0.002, np.pi, 0.0, 0.0]), 0.2, 1.0)
            still_since = 0  # ns
            async with asyncio.timeout(PATIENCE):
                async for moved in motion.batches(clock):
                    if moved.pose[-1, 2] > -0.0019:
                        still_since = int(moved.time[-1])
                    elif moved.time[-1] - still_since > 0.3 * s:  # the force has settled
                        break
            pressed = await counts()
            assert (in_air - pressed).max() > 20
            pushed = cast("tuple[float, ...]", lab.controller.box.values(["actual_TCP_force"])[0])
            assert 1.8 < pushed[2] < 2.1
            truth = cast("ObservedScene", lab.scene).truth()
            assert truth.force[0] == 0.0
            assert 1.8 < truth.force[-1] < 2.1

    asyncio.run(main())


def test_a_stall_of_the_host_delays_arm_and_fingertip_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("connectors.emulators.virtual_lab.SharedScene", ObservedScene)
    forces, motion = list[tuple[int, float]](), SharedScene.motion  # ns, N; of the arm

    def record(arm: SharedScene, instant: int) -> tuple[Reals, Reals]:
        moved = motion(arm, instant)
        forces.append((instant, arm.wrench.item(2)))
        return moved

    monkeypatch.setattr(SharedScene, "motion", record)

    async def main() -> Truth:
        async with virtual_lab(ports=ANYWHERE) as lab:
            lab.controller.box.drive.line(np.array([0.0, 0.0, -0.004, np.pi, 0.0, 0.0]), 0.04, 1.0)
            stalled = lab.scene.now()
            async for sample in TakkTile(lab.bus).batches(
                LoopClock(lab.scene.now())
            ):  # in a thread of its own
                if lab.scene.now() - stalled > 0.1 * s:
                    time.sleep(0.15)  # noqa: ASYNC251 - the stall
                    stalled = lab.scene.now()
                if lab.controller.box.drive.task == "none" and sample.counts.any():
                    break
            return cast("ObservedScene", lab.scene).truth()

    truth = run_lab(main())
    times, pressed = np.array([t for t, _ in forces]), np.array([force for _, force in forces])
    assert truth.force[-1] > 3.9
    expected: Reals = np.interp(truth.time, times, pressed)  # (n,) N
    assert np.abs(truth.force - expected).max() < 40.0 * 0.15 / 2  # 40 N/s: late by less than half the stall


def test_a_sphere_is_touched_lower_at_its_side() -> None:
    pushed = list[float]()

    async def main() -> None:
        async with virtual_lab(commanded_scene("sphere", 0.03), ports=ANYWHERE) as lab:
            box = lab.controller.box
            async with asyncio.timeout(PATIENCE):
                for place in ([0.015, 0.0, 0.0], [0.015, 0.0, -0.006]):  # its surface is at -0.004 there
                    box.drive.line(np.array([*place, np.pi, 0.0, 0.0]), 0.2, 1.0)
                    while box.drive.task != "none":  # noqa: ASYNC110 - no event for it
                        await asyncio.sleep(0.01)
                    pushed.append(cast("tuple[float, ...]", box.values(["actual_TCP_force"])[0])[2])

    asyncio.run(main())
    assert pushed[0] == 0.0
    np.testing.assert_allclose(pushed[1], 1000 * (0.006 - (0.03 - np.sqrt(0.03**2 - 0.015**2))), atol=0.2)


def test_every_device_is_where_it_says_and_gone_afterwards() -> None:
    async def main() -> dict[str, str]:
        async with virtual_lab(ports=ANYWHERE, gripper=0) as lab:
            places = lab.addresses
            for device in ("rtde", "script", "dashboard"):
                host, port = places[device].split(":")
                _, writer = await asyncio.open_connection(host, int(port))
                writer.close()
            assert lab.gripper
            client = AsyncModbusTcpClient("127.0.0.1", port=lab.gripper.port)
            assert await client.connect()
            status = await client.read_input_registers(0, count=3, device_id=lab.gripper.unit)
            assert status.registers == [0, 0, 0]
            client.close()
            assert str(lab.gripper.port) in places["gripper"]
        return places

    places = asyncio.run(main())
    assert places["takktile"] == "in this process only"
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", int(places["rtde"].split(":")[1])))


def test_the_arm_begins_above_the_surface_and_stands() -> None:
    async def main() -> None:
        async with virtual_lab(ports=ANYWHERE) as lab:
            async for moved in UrMotion("127.0.0.1", port=lab.controller.ports.rtde).batches(LoopClock()):
                np.testing.assert_allclose(moved.pose[-1], [0, 0, HEIGHT, np.pi, 0, 0], atol=1e-9)
                assert not moved.velocity[-1].any()
                return

    asyncio.run(main())


@pytest.mark.virtual
async def test_a_scene_that_fails_is_reported_when_the_lab_ends(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("connectors.emulators.virtual_lab.LARGEST_LAG", "planted")
    lab = virtual_lab(ports=ANYWHERE)
    await lab.__aenter__()
    await asyncio.sleep(0.1)
    assert "the advance of the scene has failed" in caplog.text
    with pytest.raises(EndpointError, match="the advance of the scene has failed: TypeError"):
        await lab.__aexit__(None, None, None)
