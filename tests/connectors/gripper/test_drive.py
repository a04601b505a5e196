import asyncio
import logging
from math import nan

import pytest

from connectors.gripper.robotiq import Request, register_force
from operators import EndpointError
from tests.connectors.gripper.gripper_lab import commands, counted, lab
from tests.emulators.gripper import Mechanism

pytestmark = pytest.mark.virtual
pytest.importorskip("pymodbus")


def ignored(mechanism: Mechanism, request: Request, now: int) -> None:
    del mechanism, request, now


@pytest.mark.parametrize("drop", [False, True])
async def test_a_gripper_that_restarts_is_activated_again_and_grips_again(
    *, drop: bool, caplog: pytest.LogCaptureFixture
) -> None:
    async with lab() as at, at.gripping() as gripper:
        await gripper.write(commands(30.0))
        await asyncio.sleep(5)
        at.server.restart(drop=drop)
        await asyncio.sleep(10)
        await gripper.write(commands(40.0))
        await asyncio.sleep(1)
        assert at.scene.forces == [register_force(85), 0.0, register_force(85), register_force(141)]
        assert (counted(gripper)["restarts"], counted(gripper)["failures"]) == (1, drop)
    logged = [
        record.message.split(" ", 1)[1] for record in caplog.records if record.levelno >= logging.WARNING
    ]
    lost = ["the connection is lost, retrying"] if drop else []
    back = ["works again"] if drop else []
    assert logged == [*lost, "has restarted: activating it again", *back]


async def test_a_command_to_a_restarted_gripper_is_sent_once_it_is_ready() -> None:
    async with lab() as at, at.gripping(force=15.0) as gripper:
        await asyncio.sleep(5.05)  # between two status requests
        at.server.restart(drop=False)
        await gripper.write(commands(30.0))  # starts the activation
        await asyncio.sleep(10)
        assert at.scene.forces == [15.0, 0.0, register_force(85)]
        assert [each.force for each in at.writes[2:]] == [85, 85]
        assert counted(gripper)["restarts"] == 1


async def test_the_status_is_updated_once_the_request_is_echoed(monkeypatch: pytest.MonkeyPatch) -> None:
    async with lab() as at, at.gripping(timeout=0.5) as gripper:
        await asyncio.sleep(1)
        with monkeypatch.context() as patch:
            patch.setattr(Mechanism, "request", ignored)
            await gripper.write(commands(30.0))
            before = gripper.status
            await asyncio.sleep(0.4)
            assert gripper.status is before
            await asyncio.sleep(0.2)
            with pytest.raises(EndpointError, match=r"does not accept a request within 0.5 s"):
                await gripper.write(commands(nan))
        await asyncio.sleep(5)
        assert gripper.status
        assert (gripper.status.echo, gripper.status.object_detected) == (255, True)


async def test_an_activation_that_takes_too_long_fails() -> None:
    async with lab(activation=3600.0) as at:
        loop = asyncio.get_running_loop()
        gripper, begun = at.gripper(), loop.time()
        with pytest.raises(EndpointError, match=r"is not ready within 30.0 s"):
            await gripper.open(at.run)
        assert 30 < loop.time() - begun < 30.5


async def test_a_command_whose_answer_is_missing_counts_as_not_sent() -> None:
    async with lab() as at:
        gripper = at.gripper()
        await gripper.open(at.run)
        at.server.silent = True
        await gripper.write(commands(20.0))
        await asyncio.sleep(0.5)
        assert at.writes[-1].force == 28
        with pytest.raises(EndpointError, match=r"does not answer within|is not ready"):
            await gripper.close()
