"""The emulated controller's own clock and ports, and the real classes of ur-rtde against it."""

import asyncio
import json
import socket
import sys
from collections.abc import Callable
from importlib.util import find_spec
from textwrap import dedent
from time import time_ns
from typing import Any

import numpy as np
import pytest

from connectors.emulators.lab_loop import loop_clock, run_lab
from connectors.emulators.ur_controller import Ports, UrController
from connectors.ur.rtde import Version
from flows.graph.testing import run_virtually
from flows.run.clocks import LoopClock
from operators import EndpointError
from operators.batch import Commands, Reals
from tests.connectors.emulators.faulty_ur import FaultyUrController, release_emergency, stop_in_emergency
from tests.connectors.emulators.free_arm import FreeArm
from tests.loopback import own_host
from tests.waiting import PATIENCE

HOST = "127.0.0.1"
CB3, E_SERIES, NEWEST = Version(3, 15, 8, 1), Version(5, 11, 0, 1), Version(5, 24, 0, 1)


def controller(now: Callable[[], int], drift: float = 0.0) -> FaultyUrController:
    """A CB3 controller on free ports."""
    arm = FreeArm(np.zeros(6))
    return FaultyUrController(arm, host=HOST, ports=Ports(0, 0, 0), version=CB3, now=now, drift=drift)


def test_its_clock_runs_fast_by_its_drift() -> None:
    async def main() -> float:
        async with controller(LoopClock(0).now, drift=0.01) as running:
            await asyncio.sleep(10.0)
            return running.box.timestamp

    assert run_virtually(main()) == pytest.approx(10.1, abs=0.01)


def test_an_arm_that_fails_is_no_silence(caplog: pytest.LogCaptureFixture) -> None:
    class Broken(FreeArm):
        def motion(self, time: int) -> tuple[Reals, Reals]:
            raise ZeroDivisionError

    async def main() -> bytes:
        ports = Ports(0, 0, 0)
        async with UrController(Broken(np.zeros(6)), host=HOST, ports=ports, now=LoopClock().now) as running:
            reader, writer = await asyncio.open_connection(HOST, running.ports.rtde)
            heard = await reader.read()
            writer.close()
            return heard

    with pytest.raises(EndpointError, match="the arm has failed") as caught:
        run_virtually(main())
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    assert "the arm has failed: ZeroDivisionError" in caplog.text


def test_a_port_that_is_taken_is_an_error_and_nothing_keeps_listening() -> None:
    with socket.socket() as free:
        free.bind((HOST, 0))
        port = free.getsockname()[1]

    async def main() -> None:
        async with controller(time_ns) as running:
            ports = Ports(port, 0, running.ports.script)
            with pytest.raises(EndpointError, match="cannot listen"):
                await UrController(FreeArm(np.zeros(6)), host=HOST, ports=ports).__aenter__()
            with pytest.raises(OSError, match="Connect call failed"):
                await asyncio.open_connection(HOST, port)

    asyncio.run(main())


# --- the real classes of ur-rtde -------------------------------------------------------------------------
# They know one port only, so each worker of the tests has an address of its own. Each test runs them in a
# process of their own: their constructors hold Python's lock, and after a lost link they may crash.

real = pytest.mark.skipif(find_spec("rtde_control") is None, reason="needs ur-rtde: the extra ur")

PRELUDE = """
import json, sys, time
from dashboard_client import DashboardClient
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

host = sys.argv[1]
receive = RTDEReceiveInterface(host)

def say(*values):
    print(json.dumps(values), flush=True)

def fault():
    print("fault", flush=True)
    sys.stdin.readline()

def until(true):
    end = time.monotonic() + 60
    while not true() and time.monotonic() < end:
        time.sleep(0.001)
    return true()

def speed():
    return sum(each**2 for each in receive.getActualTCPSpeed()) ** 0.5
"""


def with_ur_rtde(
    script: str, version: Version, *faults: Callable[[UrController], None], arm: FreeArm | None = None
) -> list[Any]:
    """Run a script against a controller; give what it says.

    The script knows what `PRELUDE` defines: `receive`, the real interface, `say`, `until` something is true,
    and `fault`, which returns once the next of `faults` is done.
    """
    host = own_host(5)
    arm = arm or FreeArm(np.zeros(6), acceleration=5.0)

    async def main() -> list[Any]:
        due, said = list(faults), list[Any]()
        served = UrController(arm, host=host, version=version, now=loop_clock())
        async with asyncio.timeout(PATIENCE), served as controller:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-c", PRELUDE + dedent(script), host),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
            )
            assert process.stdin
            assert process.stdout
            try:
                async for line in process.stdout:
                    if line == b"fault\n":
                        due.pop(0)(controller)
                        process.stdin.write(b"\n")
                    elif line.startswith(b"["):  # else the library talks to itself
                        said.append(json.loads(line))
                _, errors = await process.communicate()
            finally:
                if process.returncode is None:
                    process.kill()
                    await process.communicate()
        assert process.returncode == 0, errors.decode()
        assert not due
        return said

    return run_lab(main())


@real
@pytest.mark.parametrize("version", [CB3, E_SERIES, NEWEST], ids=str)
def test_the_real_receiver_reads_what_the_arm_does(version: Version) -> None:
    script = """
        say(receive.getActualTCPPose(), receive.getRobotMode(), receive.getSafetyMode())
        say(receive.getRuntimeState(), receive.isProtectiveStopped(), receive.isEmergencyStopped())
        fault()
        say(until(lambda: speed() > 0), receive.getActualTCPSpeed())
        before = receive.getTimestamp()
        say(until(lambda: receive.getTimestamp() > before))
    """
    arm = FreeArm(np.array([0.1, 0.2, 0.3, 0.0, 3.0, 0.0]))

    def push(_: UrController) -> None:
        arm.command(Commands(np.array([0]), np.array([np.nan]), np.array([[0.1, 0, 0, 0, 0, 0.5]])))

    assert with_ur_rtde(script, version, push, arm=arm) == [
        [[0.1, 0.2, 0.3, 0.0, 3.0, 0.0], 7, 1],
        [1, False, False],
        [True, [0.1, 0, 0, 0, 0, 0.5]],
        [True],
    ]


@real
@pytest.mark.parametrize("version", [CB3, E_SERIES, NEWEST], ids=str)
def test_the_real_control_moves_and_stops_the_arm(version: Version) -> None:
    script = """
        control = RTDEControlInterface(host)
        say("uploaded", control.isProgramRunning(), until(lambda: receive.getRuntimeState() == 2))
        say("moveL", control.moveL([0.02, -0.01, 0.005, 0, 0, 0.05], 0.25, 1.2), receive.getActualTCPPose())
        say("speedL", control.speedL([0, 0.05, 0, 0, 0, 0.2], 1.0), until(lambda: speed() > 0.2))
        say("speedStop", control.speedStop(2.0), until(lambda: speed() < 1e-3))
        control.speedL([-0.05, 0, 0, 0, 0, 0], 1.0)
        until(lambda: speed() > 0.049)
        say("stopL", control.stopL(2.0), until(lambda: speed() < 1e-3))
        control.moveL([1, 0, 0, 0, 0, 0], 0.1, 1.2, True)
        say("asynchronous", until(lambda: control.getAsyncOperationProgress() >= 0 and speed() > 0.09))
        say("stopJ", control.stopJ(2.0), control.getAsyncOperationProgress() < 0, control.isSteady())
        control.stopScript()
        say("ended", control.isProgramRunning(), control.moveL([0, 0, 0, 0, 0, 0], 0.1, 1.2))
    """
    said = {name: values for name, *values in with_ur_rtde(script, version)}
    assert said.pop("moveL") == [True, pytest.approx([0.02, -0.01, 0.005, 0, 0, 0.05], abs=1e-4)]
    assert said == {
        "uploaded": [True, True],
        "speedL": [True, True],
        "speedStop": [True, True],
        "stopL": [None, True],
        "asynchronous": [True],
        "stopJ": [None, True, True],
        "ended": [False, False],
    }


@real
def test_the_real_control_sees_stops_and_comes_back_after_them() -> None:
    script = """
        control, dashboard = RTDEControlInterface(host), DashboardClient(host)
        dashboard.connect()

        say("triggered", control.triggerProtectiveStop(), until(receive.isProtectiveStopped))
        say("refused", control.moveL([0.1, 0, 0, 0, 0, 0], 0.1, 1.2), dashboard.safetystatus())
        until(lambda: unlocked())
        say("unlocked", until(lambda: not receive.isProtectiveStopped()), dashboard.safetystatus())
        say("again", control.reuploadScript(), until(control.isProgramRunning))

        control.speedL([0.05, 0, 0, 0, 0, 0], 1.0)
        until(lambda: speed() > 0.049)
        fault()
        say("emergency", until(receive.isEmergencyStopped), until(lambda: speed() < 1e-3))
        say("powerless", control.moveL([0.1, 0, 0, 0, 0, 0], 0.1, 1.2), dashboard.robotmode())
        fault()
        say("back", dashboard.robotmode(), control.reuploadScript(), until(control.isProgramRunning))
        say("moves", control.moveL([0.01, 0, 0, 0, 0, 0], 0.25, 1.2))
    """
    unlocked = """
        def unlocked():
            try:
                dashboard.unlockProtectiveStop()
            except RuntimeError:
                return False
            return True
    """
    said = with_ur_rtde(
        dedent(unlocked) + dedent(script),
        E_SERIES,
        lambda controller: stop_in_emergency(controller.box),
        lambda controller: release_emergency(controller.box),
    )
    assert said == [
        ["triggered", True, True],
        ["refused", False, "Safetystatus: PROTECTIVE_STOP"],
        ["unlocked", True, "Safetystatus: NORMAL"],
        ["again", True, True],
        ["emergency", True, True],
        ["powerless", False, "Robotmode: POWER_OFF"],
        ["back", "Robotmode: RUNNING", True, True],
        ["moves", True],
    ]
