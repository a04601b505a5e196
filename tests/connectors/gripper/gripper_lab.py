"""Gripper emulated in memory, for tests of its sink."""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from connectors import Gripper
from connectors.gripper.robotiq import Request
from flows.run.clocks import LoopClock
from operators import s
from operators.batch import Commands
from operators.ports import Run
from tests.emulators.gripper import HOST, PORT, GripperServer, asked


@dataclass
class Lab:
    """Emulated gripper on the event loop's time, and the requests that it received."""

    server: GripperServer
    run: Run
    asked: list[tuple[float, bytes]]  # s of the loop, and a request's bytes after the transaction's number
    answered: list[bytes]  # the same

    def gripper(self, **parameters: Any) -> Gripper:
        """Return a sink."""
        return Gripper(HOST, PORT, **parameters)

    @asynccontextmanager
    async def gripping(self, force: float | None = None, **parameters: Any) -> AsyncGenerator[Gripper]:
        """Open a sink for a block, and command a force (N) if one is given."""
        gripper = self.gripper(**parameters)
        await gripper.open(self.run)
        if force is not None:
            await gripper.write(commands(force))
        try:
            yield gripper
        finally:
            await gripper.close()

    @property
    def writes(self) -> list[Request]:
        """Requests to the gripper."""
        return [asked(data[-6:]) for _, data in self.asked if data[5] == 16]

    @property
    def forces(self) -> list[float]:
        """Grip forces on the object, N."""
        return self.server.mechanism.forces


@asynccontextmanager
async def lab(**parameters: Any) -> AsyncGenerator[Lab]:
    """Serve a gripper for a block."""
    loop, received, answered = asyncio.get_running_loop(), list[tuple[float, bytes]](), list[bytes]()
    begun = loop.time()
    server = GripperServer(now=lambda: round((loop.time() - begun) * s), **parameters)

    def listen(sending: bool, data: bytes) -> bytes:
        if sending:
            answered.append(data[2:])
        elif data:
            received.append((loop.time(), data[2:]))
        return data

    server.trace = listen
    async with server:
        yield Lab(server, Run("run1", "live", LoopClock(), 0), received, answered)


def commands(*forces: float) -> Commands:
    """Return a row for each force (N), 1 ns apart."""
    return Commands(np.arange(len(forces)), np.array(forces, float)).check()
