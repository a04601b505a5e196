"""A gripper that is served in memory, for what commands it."""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from math import nan
from typing import Any, cast

import numpy as np

from connectors import Gripper
from connectors.gripper.grip_force import ForceScale
from connectors.gripper.robotiq import Request
from flows.run.clocks import LoopClock
from operators import s
from operators.batch import Commands
from operators.ports import Run
from tests.connectors.emulators.faulty_gripper import FaultyGripperServer

IN_MEMORY = "__pymodbus_nullmodem"  # pymodbus' own wire without sockets: virtual time cannot overtake it
PORT = 5020
SCALE = ForceScale()


@dataclass
class Scene:
    """Remembers with what force it was gripped (N), and since when (s)."""

    told: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    gripped: asyncio.Event = field(default_factory=asyncio.Event)

    def command(self, commands: Commands) -> None:
        """Remember it."""
        self.told += zip((commands.time / s).tolist(), commands.force.tolist(), strict=True)
        self.gripped.set()

    @property
    def forces(self) -> list[float]:
        """In the order in which they came, N."""
        return [force for _, force in self.told]


@dataclass
class Lab:
    """A served gripper on the event loop's time, a sink that commands it, and what goes over the wire."""

    server: FaultyGripperServer
    scene: Scene
    run: Run
    asked: list[tuple[float, bytes]]  # s of the loop, and a request's bytes after the transaction's number

    def gripper(self, **parameters: Any) -> Gripper:  # noqa: ANN401 - those of a gripper
        """The sink."""
        return Gripper(self.server.host, self.server.port, **parameters)

    @asynccontextmanager
    async def gripping(self, **parameters: Any) -> AsyncGenerator[Gripper]:  # noqa: ANN401 - those of a gripper
        """The sink, open meanwhile."""
        gripper = self.gripper(**parameters)
        await gripper.open(self.run)
        try:
            yield gripper
        finally:
            await gripper.close()

    @property
    def writes(self) -> list[Request]:
        """What was asked of the gripper."""
        return [Request.decode(data[-6:]) for _, data in self.asked if data[5] == 16]


@asynccontextmanager
async def lab(
    host: str = IN_MEMORY,
    port: int = PORT,
    **parameters: Any,  # noqa: ANN401 - those of a server
) -> AsyncGenerator[Lab]:
    """A gripper, served meanwhile."""
    loop, scene, asked = asyncio.get_running_loop(), Scene(), list[tuple[float, bytes]]()
    begun = loop.time()
    server = FaultyGripperServer(
        scene, host=host, port=port, now=lambda: round((loop.time() - begun) * s), **parameters
    )
    pass_on = server._trace  # pyright: ignore[reportPrivateUsage]

    def listen(sending: bool, data: bytes) -> bytes:  # noqa: FBT001 - as pymodbus calls it
        if data and not sending:
            asked.append((loop.time(), data[2:]))
        return pass_on(sending, data)

    server._trace = listen  # type: ignore[method-assign]
    async with server:
        yield Lab(server, scene, Run("run1", "live", LoopClock(), 0), asked)


def commands(*forces: float, velocity: float = nan) -> Commands:
    """A row for each force (N), 1 ns apart."""
    return Commands(
        np.arange(len(forces)), np.array(forces, float), np.full((len(forces), 6), velocity)
    ).check()


def counted(gripper: Gripper) -> dict[str, int]:
    """What the sink says that it counted."""
    return cast("dict[str, int]", gripper.describe()["counted"])
