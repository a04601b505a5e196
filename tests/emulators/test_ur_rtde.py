"""The real classes of ur-rtde against the emulated controller.

They know one port only, so each worker of the tests has an address of its own. Each test runs them in a
process of their own: their constructors hold Python's lock, and after a lost link they may crash.
"""

import asyncio
import json
import sys
from collections.abc import Callable
from importlib.util import find_spec
from textwrap import dedent
from typing import Any

import numpy as np
import pytest

from connectors.ur.rtde import Version
from flows.run.clocks import LoopClock
from operators.batch import Reals
from tests.emulators.ur_controller import CB3, E_SERIES, UrController
from tests.loopback import own_host
from tests.waiting import PATIENCE

NEWEST = Version(5, 24, 0, 1)
ORIGIN = np.zeros(6)
real = pytest.mark.skipif(find_spec("rtde_control") is None, reason="needs ur-rtde: the extra ur")

PRELUDE = """
import json, sys, time
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

def at(pose):  # what was received last may be a cycle old
    return all(abs(a - b) < 1e-4 for a, b in zip(pose, receive.getActualTCPPose(), strict=True))
"""


def with_ur_rtde(
    script: str, version: Version, *faults: Callable[[UrController], None], pose: Reals = ORIGIN
) -> list[Any]:
    """Run a script against a controller; return what it says.

    The script knows what `PRELUDE` defines: `receive`, the real interface, `say`, `until` something is true,
    and `fault`, which returns once the next of `faults` is done.
    """
    host = own_host(5)

    async def main() -> list[Any]:
        due, said = list(faults), list[Any]()
        served = UrController(pose, host=host, version=version, now=LoopClock().now)
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

    return asyncio.run(main())


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
    pose = np.array([0.1, 0.2, 0.3, 0.0, 3.0, 0.0])

    def push(controller: UrController) -> None:
        controller.box.drive.velocity = np.array([0.1, 0, 0, 0, 0, 0.5])

    assert with_ur_rtde(script, version, push, pose=pose) == [
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
        pose = [0.02, -0.01, 0.005, 0, 0, 0.05]
        say("moveL", control.moveL(pose, 0.25, 1.2), until(lambda: at(pose)))
        say("speedL", control.speedL([0, 0.05, 0, 0, 0, 0.2], 1.0), until(lambda: speed() > 0.2))
        say("speedStop", control.speedStop(2.0), until(lambda: speed() < 1e-3))
        control.speedL([-0.05, 0, 0, 0, 0, 0], 1.0)
        until(lambda: speed() > 0.049)
        say("stopL", control.stopL(2.0), until(lambda: speed() < 1e-3))
        control.moveL([1, 0, 0, 0, 0, 0], 0.1, 1.2, True)
        say("asynchronous", until(lambda: control.getAsyncOperationProgress() >= 0 and speed() > 0.09))
        say("stops", control.stopL(2.0), control.getAsyncOperationProgress() < 0)
        control.stopScript()
        say("ended", control.isProgramRunning(), control.moveL([0, 0, 0, 0, 0, 0], 0.1, 1.2))
    """
    said = {name: values for name, *values in with_ur_rtde(script, version)}
    assert said.pop("moveL") == [True, True]
    assert said == {
        "uploaded": [True, True],
        "speedL": [True, True],
        "speedStop": [True, True],
        "stopL": [None, True],
        "asynchronous": [True],
        "stops": [None, True],
        "ended": [False, False],
    }
