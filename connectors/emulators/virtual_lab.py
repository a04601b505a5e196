"""The virtual lab: one scene, served as devices over their own protocols.

A UR controller, a TakkTile bus and a gripper share one `Lab`: the arm that is commanded drags, and presses,
the fingertip whose counts come back; the gripper's force presses it, too, and the newest one counts. The
surface's middle, its highest point, is the origin of the arm's base frame; its axes are the frame's.
"""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import Final

from connectors.emulators.gripper_server import GripperServer
from connectors.emulators.i2c_bus import I2cBus
from connectors.emulators.pressing import PressingArm
from connectors.emulators.shared_scene import Lab
from connectors.emulators.ur_controller import PORTS, Ports, UrController
from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import Commanded, Curvature, Scene
from connectors.ur.rtde import Version
from operators.batch import s

RADIUS: Final = Scene().radius  # m, of a curved surface
HEIGHT: Final = 0.02  # m above the surface, where the fingertip is at first
LOOPBACK: Final = "127.0.0.1"
I2C: Final = "/dev/i2c-1"
UR10: Final = Version(3, 15, 8, 0)  # the paper's arm; 125 Hz
_BEHIND: Final = 2 * s  # ns that the scene may be behind when nobody asks


@dataclass(frozen=True)
class VirtualLab:
    """What is served, and where."""

    lab: Lab
    bus: I2cBus
    controller: UrController
    path: str  # of the bus, for smbus2 in this process
    gripper: GripperServer | None

    @property
    def places(self) -> dict[str, str]:
        """Where each device is."""
        host, ports, gripper = self.controller.host, self.controller.ports, self.gripper
        return {
            "takktile": f"{self.path}, in this process only",
            "rtde": f"{host}:{ports.rtde}",
            "script": f"{host}:{ports.script}",
            "dashboard": f"{host}:{ports.dashboard}",
            **({"gripper": f"modbus://{gripper.host}:{gripper.port}/{gripper.unit}"} if gripper else {}),
        }


def scene(curvature: Curvature = "plane", radius: float = RADIUS) -> Scene:
    """A surface (radius in m), a fingertip above it, noisy as a real one, and an arm that awaits commands."""
    return Scene(Commanded(), curvature, radius, parameters=Parameters(noise=0.6))


@asynccontextmanager
async def virtual_lab(
    scene: Scene | None = None,
    seed: int = 0,
    *,
    fingers: tuple[int, ...] = (0,),
    host: str = LOOPBACK,
    ports: Ports = PORTS,
    gripper: int | None = None,
    path: str = I2C,
    version: Version = UR10,
) -> AsyncGenerator[VirtualLab]:
    """Serve a scene for as long as the block lasts.

    Args:
        scene: What happens; the default is a plane above which the arm waits for commands.
        seed: Of all noise.
        fingers: Fingertips; each sits on the bus in the row of its number.
        host: The address that the servers listen on.
        ports: Of the controller.
        gripper: Port of the gripper, 0 for any; None: there is none. Needs the extra `gripper`.
        path: Of the I2C bus, which only this process has: no kernel serves it.
        version: Of the controller's software: 3.x runs at 125 Hz, 5.x at 500.

    Raises:
        EndpointError: if a port is taken.
        InputError: if a gripper is asked for and pymodbus is not installed.
        ParameterError: if there is no such fingertip.
    """
    from connectors.emulators.i2c_device import served  # noqa: PLC0415 - loads smbus2: only to serve it

    lab = await asyncio.to_thread(lambda: Lab(scene, seed, fingers=fingers))
    bus = I2cBus(lab, {finger: finger for finger in fingers}, now=lab.now)
    arm = PressingArm(lab, HEIGHT, curvatures=lab.scene.curvatures)
    controller = UrController(arm, host=host, ports=ports, version=version, now=lab.now)
    server = None if gripper is None else GripperServer(lab, host=host, port=gripper, now=lab.now)
    async with AsyncExitStack() as running:
        running.enter_context(served(bus, path))
        await running.enter_async_context(controller)
        if server:
            await running.enter_async_context(server)
        ageing = asyncio.create_task(_age(lab))
        try:
            yield VirtualLab(lab, bus, controller, path, server)
        finally:
            ageing.cancel()
            await asyncio.gather(ageing, return_exceptions=True)


async def _age(lab: Lab) -> None:
    """Let time go by though nobody asks, so that who asks later need not wait for all of it."""
    while True:
        await asyncio.sleep(_BEHIND / s / 2)
        await asyncio.to_thread(lab.advance, lab.now() - _BEHIND)
