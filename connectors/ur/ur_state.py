"""What a UR controller says of its arm's state, over RTDE: where it is, and whether it may move."""

import asyncio
from dataclasses import dataclass
from math import dist, hypot, inf, nan
from typing import Final, NamedTuple

import numpy as np

from connectors.ur.rtde import PORT, RtdeError
from connectors.ur.rtde_link import SILENT, STALLED, RtdeLink, mistyped, reason
from operators.errors import EndpointError, ParameterError
from operators.ports import Clock
from operators.rotation import onward

OUTPUTS: Final = (
    "timestamp",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
    "robot_mode",
    "safety_mode",
)
TYPES: Final = ("DOUBLE", "VECTOR6D", "VECTOR6D", "VECTOR6D", "INT32", "INT32")
RUNNING: Final = 7  # robot mode; RTDE guide
SAFETY: Final = {  # RTDE guide
    1: "",
    2: "",  # reduced mode
    3: "protective stop",
    4: "recovery mode",
    5: "safeguard stop",
    6: "emergency stop of the system",
    7: "emergency stop",
    8: "violation of a safety limit",
    9: "fault",
}
STILL: Final = 1e-3  # m/s, rad/s
NEAR: Final = 5e-4  # m; an arm repeats to 1e-4
NEAR_TURN: Final = 5e-3  # rad

_ROW: Final = np.dtype(
    [
        ("recipe", "u1"),
        ("timestamp", ">f8"),
        ("pose", ">f8", 6),
        ("velocity", ">f8", 6),
        ("force", ">f8", 6),
        ("robot_mode", ">i4"),
        ("safety_mode", ">i4"),
    ]
)


class State(NamedTuple):
    """An arm at one instant, in the base frame."""

    pose: tuple[float, ...]  # (6,) m and rotation vector in rad
    velocity: tuple[float, ...]  # (6,) m/s and rad/s
    force: tuple[float, ...] = (nan, nan, nan)  # (3,) N, on the tool at the TCP; NaN: unknown
    robot_mode: int = RUNNING
    safety_mode: int = 1

    @property
    def still(self) -> bool:
        """Whether it stands."""
        return max(map(abs, self.velocity)) < STILL

    def at(self, pose: tuple[float, ...]) -> bool:
        """Whether it stands at a pose (6,)."""
        turn = hypot(*onward((self.pose[3], self.pose[4], self.pose[5]), (pose[3], pose[4], pose[5])))
        return self.still and dist(self.pose[:3], pose[:3]) < NEAR and turn < NEAR_TURN


@dataclass(frozen=True, slots=True)
class Bounds:
    """Where the TCP may be, and how hard it may press.

    Raises:
        ParameterError: if there is no room.

    >>> bounds = Bounds((0, 0, 0), (1, 1, 1), force=20)
    >>> bounds.breach(State((0.5, 0.5, 1.1, 0, 0, 0), (0,) * 6))
    'at z 1.1000 m it is outside its workspace'
    """

    low: tuple[float, float, float]  # m, base frame
    high: tuple[float, float, float]  # m
    force: float = inf  # N

    def __post_init__(self) -> None:
        if not all(a < b for a, b in zip(self.low, self.high, strict=True)):
            raise ParameterError("Bounds", "high", self.high, f"above low, {self.low} m, on each axis")
        if not self.force > 0:
            raise ParameterError("Bounds", "force", self.force, "above 0 N")

    def breach(self, state: State) -> str:
        """Why an arm in this state has to be stopped; empty: it need not be."""
        if state.safety_mode != 1 and (why := SAFETY.get(state.safety_mode, "unknown safety mode")):
            return why
        if state.robot_mode != RUNNING:
            return f"the arm is not running (robot mode {state.robot_mode})"
        for axis, low, at, high in zip("xyz", self.low, state.pose, self.high, strict=False):
            if not low <= at <= high:
                return f"at {axis} {at:.4f} m it is outside its workspace"
        if (push := hypot(*state.force)) > self.force:  # NaN is not
            return f"a force of {push:.1f} N, more than {self.force:g} N"
        return ""


class Watch:
    """Reads an arm's state from its controller, package after package.

    Args:
        clock: Of the run.
        host: The controller.
        port: Its RTDE port.
        patience: For a connection, and from package to package, s.
    """

    def __init__(self, clock: Clock, host: str, port: int = PORT, patience: float = 1.0) -> None:
        self._link = RtdeLink(clock, OUTPUTS, 125.0)
        self._host, self._port, self._patience = host, port, patience
        self._place = f"rtde://{host}:{port}"

    async def open(self) -> State:
        """Connect; the first state.

        Raises:
            EndpointError: if the controller does not tell.
        """
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(self._patience):
                await loop.create_connection(lambda: self._link, self._host, self._port)
        except TimeoutError as error:
            raise EndpointError(self._place, SILENT.format(self._patience)) from error
        except OSError as error:
            raise EndpointError(self._place, reason(error)) from error
        return (await self.next())[-1]

    async def next(self) -> list[State]:
        """The states that came since the last call, at least one.

        Raises:
            EndpointError: if the controller does not tell.
        """
        try:
            async with asyncio.timeout(self._patience):
                _, packages = await self._link.take()
        except TimeoutError as error:
            raise EndpointError(self._place, STALLED.format(self._patience)) from error
        except (OSError, RtdeError) as error:
            raise EndpointError(self._place, reason(error)) from error
        if self._link.types != TYPES:
            raise EndpointError(self._place, mistyped(OUTPUTS, self._link.types, TYPES))
        rows = np.frombuffer(packages, _ROW)
        force = rows["force"][:, :3]  # (n, 3)
        fields = rows["pose"], rows["velocity"], force, rows["robot_mode"], rows["safety_mode"]
        return [
            State(tuple(pose), tuple(velocity), tuple(push), mode, safety)
            for pose, velocity, push, mode, safety in zip(*(each.tolist() for each in fields), strict=True)
        ]

    async def close(self) -> None:
        """Let go of the connection."""
        await self._link.close()
