"""Virtual lab: one simulated scene behind an emulated UR controller, a TakkTile bus and a gripper.

The arm moves the fingertip on the bus and presses it onto the surface; the force of the gripper is added. The
highest point of the surface, its middle, is the origin of the arm's base frame.
"""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import Final

from connectors.emulators.gripper_mechanism import Mechanism
from connectors.emulators.gripper_server import GripperServer
from connectors.emulators.i2c_bus import EmulatedI2cBus
from connectors.emulators.lab_loop import LabLoop, loop_clock
from connectors.emulators.shared_scene import SharedScene
from connectors.emulators.ur_controller import PORTS, Ports, UrController
from connectors.sim.scene import Scene
from connectors.ur.rtde import Version
from operators.batch import s
from storage.background_task import BackgroundTask

HEIGHT: Final = 0.02  # m, initial height of the fingertip above the surface
LOOPBACK: Final = "127.0.0.1"
UR10_CB3: Final = Version(3, 15, 8, 0)  # the arm of the paper; 125 Hz
LARGEST_LAG: Final = 2 * s  # ns by which an idle scene lags the clock


@dataclass(frozen=True)
class VirtualLab:
    """A running virtual lab; pass `bus` to `TakkTile`.

    It runs on the time of its event loop. In a `LabLoop` (`run_lab`) a busy host makes the lab slow; in
    another loop the arm moves on while a busy host delays its commands.
    """

    scene: SharedScene
    bus: EmulatedI2cBus
    controller: UrController
    gripper: GripperServer | None

    @property
    def addresses(self) -> dict[str, str]:
        """Address of each device."""
        host, ports, gripper = self.controller.host, self.controller.ports, self.gripper
        return {
            "takktile": "in this process only",
            "rtde": f"{host}:{ports.rtde}",
            "script": f"{host}:{ports.script}",
            "dashboard": f"{host}:{ports.dashboard}",
            **({"gripper": f"modbus://{gripper.host}:{gripper.port}/{gripper.unit}"} if gripper else {}),
        }

    def wait_for_commands(self) -> None:
        """Stop the time of the `LabLoop` while a command of the arm's program is overdue on a busy host."""
        loop = asyncio.get_running_loop()
        assert isinstance(loop, LabLoop)
        loop.hold_while(lambda: self.controller.command_overdue)


@asynccontextmanager
async def virtual_lab(
    scene: Scene | None = None,
    seed: int = 0,
    *,
    fingers: tuple[int, ...] = (0,),
    host: str = LOOPBACK,
    ports: Ports = PORTS,
    gripper: int | None = None,
) -> AsyncGenerator[VirtualLab]:
    """Serve a scene while the block runs.

    Args:
        scene: Scene to serve; default `connectors.sim.scene.commanded_scene()`, a plane.
        seed: Random seed; the same seed and the same requests give identical counts.
        fingers: Fingertips; the row of each on the bus is its number.
        host: Address on which the servers listen (default loopback).
        ports: Ports of the UR controller.
        gripper: Port of the gripper, 0 for any free one; None for no gripper. Needs the extra `gripper`.

    Raises:
        EndpointError: if a port is in use, or a background task has failed.
        InputError: if a gripper is requested and pymodbus is not installed.
        ParameterError: if a finger is not from 0 to 7.
    """
    now = loop_clock()
    shared = await asyncio.to_thread(
        lambda: SharedScene(scene, seed, fingers=fingers, height=HEIGHT, now=now)
    )
    bus = EmulatedI2cBus(shared, {finger: finger for finger in fingers}, now=now)
    controller = UrController(shared, host=host, ports=ports, version=UR10_CB3, now=now)
    server = None
    if gripper is not None:
        server = GripperServer(Mechanism(shared, now()), host=host, port=gripper, now=now)
    async with AsyncExitStack() as running:
        await running.enter_async_context(controller)
        if server:
            await running.enter_async_context(server)
        advancing = BackgroundTask("virtual lab", "the advance of the scene", _advance(shared))
        try:
            yield VirtualLab(shared, bus, controller, server)
        finally:
            await advancing.end()
        advancing.check()


async def _advance(scene: SharedScene) -> None:
    """Advance an idle scene periodically, so that the next request is fast."""
    while True:
        await asyncio.sleep(LARGEST_LAG / s / 2)
        await asyncio.to_thread(scene.advance, scene.now() - LARGEST_LAG)
