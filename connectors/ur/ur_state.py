"""State of a UR arm, read over RTDE, and the bounds within which it may move."""

from dataclasses import dataclass
from math import dist, hypot, inf, nan
from typing import Final, NamedTuple, TypeAlias

from connectors.ur.rtde import PORT, RtdeClient
from operators.checks import check_above
from operators.errors import ParameterError
from operators.ports import Clock
from operators.rotation import compose, quaternion, rotate, rotation_difference

Point: TypeAlias = tuple[float, float, float]  # m
Pose: TypeAlias = tuple[float, float, float, float, float, float]  # m and rotation vector in rad, or per s

OUTPUTS: Final = {  # after the timestamp in the order of `ArmState`
    "timestamp": "DOUBLE",
    "actual_TCP_pose": "VECTOR6D",
    "actual_TCP_speed": "VECTOR6D",
    "actual_TCP_force": "VECTOR6D",
    "robot_mode": "INT32",
    "safety_mode": "INT32",
    "target_speed_fraction": "DOUBLE",
}
RATE: Final = 125.0  # Hz; every controller supports it
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
STANDSTILL: Final = 1e-3  # m/s, rad/s; slower counts as standing
POSITION_TOLERANCE: Final = 5e-4  # m; a UR arm has a repeatability of 1e-4
ROTATION_TOLERANCE: Final = 5e-3  # rad


class ArmState(NamedTuple):
    """State of an arm at one instant, in the base frame."""

    pose: Pose  # m and rotation vector in rad
    velocity: Pose  # m/s and rad/s
    force: Point = (nan, nan, nan)  # N, on the tool at the TCP; NaN: unknown
    robot_mode: int = RUNNING
    safety_mode: int = 1
    slider: float = 1.0  # of the teach pendant; share of the commanded speed that the arm reaches

    @property
    def still(self) -> bool:
        """True if the arm stands still."""
        return max(map(abs, self.velocity)) < STANDSTILL

    @property
    def stopped(self) -> str:
        """Reason why the arm cannot move; empty if it can."""
        if self.safety_mode != 1 and (reason := SAFETY.get(self.safety_mode, "unknown safety mode")):
            return reason
        return "" if self.robot_mode == RUNNING else f"the arm is not running (robot mode {self.robot_mode})"

    @property
    def slowed(self) -> str:
        """Warning that the arm moves slower than commanded; empty if it does not."""
        slow = f"its speed slider is at {self.slider:.0%}, so that it moves slower than planned"
        return slow if self.slider < 1 else ""

    def stands_at(self, pose: Pose) -> bool:
        """Return True if the arm stands still at a pose."""
        turn = hypot(*rotation_difference(self.pose[3:], pose[3:]))
        near = dist(self.pose[:3], pose[:3]) < POSITION_TOLERANCE and turn < ROTATION_TOLERANCE
        return self.still and near


@dataclass(frozen=True, slots=True)
class Bounds:
    """Workspace of the TCP and limit of the force on it.

    Raises:
        ParameterError: if the workspace is empty or the force limit is not above 0 N.

    >>> bounds = Bounds((0, 0, 0), (1, 1, 1), force=20)
    >>> bounds.violation(ArmState((0.5, 0.5, 1.1, 0, 0, 0), (0,) * 6))
    'at z 1.1000 m it is outside its workspace'
    """

    low: Point  # m, base frame
    high: Point  # m
    force: float = inf  # N

    def __post_init__(self) -> None:
        if not all(a < b for a, b in zip(self.low, self.high, strict=True)):
            raise ParameterError("Bounds", "high", self.high, f"above low, {self.low} m, on each axis")
        check_above("Bounds", "force", self.force, 0, "N")

    def violation(self, state: ArmState) -> str:
        """Return why an arm in this state must be stopped, or an empty text."""
        if state.stopped:
            return state.stopped
        for axis, low, at, high in zip("xyz", self.low, state.pose, self.high, strict=False):
            if not low <= at <= high:
                return f"at {axis} {at:.4f} m it is outside its workspace"
        if (push := hypot(*state.force)) > self.force:  # False for an unknown force, NaN
            return f"a force of {push:.1f} N, more than {self.force:g} N"
        return ""


def offset_pose(pose: Pose, offset: Point = (0.0, 0.0, 0.0), yaw: float = 0.0) -> Pose:
    """Return a pose moved (m) in its own frame and rotated (rad) about its own z.

    >>> [round(each, 6) for each in offset_pose((0.4, 0, 0.1, 3.141592653589793, 0, 0), (0, 0.01, -0.02))[:3]]
    [0.4, -0.01, 0.12]
    """
    by = quaternion(pose[3:])
    x, y, z = rotate(offset, by)
    a, b, c = rotate((0.0, 0.0, yaw), by)
    u, v, w = compose(pose[3:], by=(a, b, c)) if yaw else pose[3:]
    return pose[0] + x, pose[1] + y, pose[2] + z, u, v, w


def state_client(clock: Clock, host: str) -> RtdeClient:
    """Return a client for `receive_states`."""
    return RtdeClient(clock, host, PORT, OUTPUTS, RATE)


async def receive_states(client: RtdeClient) -> list[ArmState]:
    """Return the states received since the last call; wait if there are none."""
    _, rows = await client.receive()
    columns = [rows[name].tolist() for name in OUTPUTS]
    return [
        ArmState(tuple(pose), tuple(velocity), tuple(force[:3]), *rest)
        for _, pose, velocity, force, *rest in zip(*columns, strict=True)
    ]


async def read_state(clock: Clock, host: str) -> ArmState:
    """Return the newest state of an arm."""
    client = state_client(clock, host)
    try:
        await client.connect()
        return (await receive_states(client))[-1]
    finally:
        await client.close()
