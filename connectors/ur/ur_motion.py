"""Source of the motion of a UR arm over RTDE."""

from collections.abc import AsyncGenerator, AsyncIterator
from dataclasses import dataclass, field
from math import isclose
from typing import Final, cast

import numpy as np

from connectors.rate_check import DIAGNOSIS, rate_finding
from connectors.ur.rtde import PORT, Rows, RtdeClient
from connectors.ur.ur_state import OUTPUTS as STATE_OUTPUTS
from connectors.ur.ur_state import receive_states
from operators.batch import Motion, Times, s
from operators.errors import EndpointError, ParameterError
from operators.ports import Clock, Description, Finding, Json, Source

OUTPUTS: Final = {"timestamp": "DOUBLE", "actual_TCP_pose": "VECTOR6D", "actual_TCP_speed": "VECTOR6D"}
LOWEST_RATE: Final = 2.0  # Hz; longer pauses count as a failure
E_SERIES_RATE: Final = 500.0  # Hz
CB3_RATE: Final = 125.0  # Hz
CB3: Final = 3  # highest major version of CB3 software

_MAX_UPTIME: Final = 4e9  # s, 128 years


@dataclass(eq=False)
class UrMotion(Source[Motion]):
    """Pose and velocity of a UR arm's tool centre point (TCP) in the base frame.

    `time` is the arrival of a package, `device_time` the controller's timestamp (ns since its start). A flow
    converts the latter into host time, without the jitter of the network::

        motion = flow.source(UrMotion("10.0.0.2"))
        motion.to(dataset)  # as received
        samples = touch & (motion | DeviceClock()) | Align(within=20 * ms)

    The connection fails if the controller refuses, closes or resets it, if no package arrives within 1 s,
    and if the controller's clock goes back (it has restarted). Repeated packages are dropped.

    Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide".

    Args:
        host: Address of the controller.
        rate: Packages per second, Hz; at most 125 on a CB3 controller, 500 on an e-Series.

    Raises:
        ParameterError: if the host is empty, or no controller has the rate.
    """

    host: str
    rate: float = 125.0
    port: int = PORT
    _about: dict[str, Json] = field(default_factory=dict[str, Json], init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.host:
            raise ParameterError("UrMotion", "host", self.host, "the address of a controller")
        if not LOWEST_RATE <= self.rate <= E_SERIES_RATE or not _divides(self.rate, E_SERIES_RATE):
            must_be = "500 Hz divided by an integer, from 2 Hz: 500, 250, 166.667, 125"
            raise ParameterError("UrMotion", "rate", self.rate, must_be)
        address = f"rtde://{self.host}:{self.port}"
        self._about |= {"arm": "UR", "address": address, "rate_hz": self.rate}
        self._about |= {"controller": None, "messages": 0}

    @property
    def kind(self) -> type[Motion]:
        """Type of the batches."""
        return Motion

    async def batches(self, clock: Clock) -> AsyncIterator[Motion]:
        """Yield the packages of one connection, each once and in order; unread packages form one batch.

        Raises:
            EndpointError: if the connection fails.
        """
        client = RtdeClient(clock, self.host, self.port, OUTPUTS, self.rate)
        newest = -1  # ns, newest timestamp of this connection
        messages = cast("int", self._about["messages"])  # of the controller, on earlier connections
        try:
            await client.connect()
            self._check_controller(client)
            while True:
                motion = _decode(client.endpoint, *await client.receive())
                self._about["messages"] = messages + client.texts
                steps = np.diff(motion.device_time, prepend=newest)
                back = steps < 0
                if len(new := motion[(steps > 0) & ~np.logical_or.accumulate(back)]):
                    newest = new.device_time.item(-1)
                    yield new
                if back.any():
                    raise EndpointError(client.endpoint, "its clock went back: the controller restarted")
        finally:
            await client.close()

    async def diagnose(self, clock: Clock) -> AsyncGenerator[Finding]:
        """Check the controller, the state of the arm and the rate of its packages.

        Raises:
            EndpointError: if the connection fails, or the controller does not have the rate.
        """
        outputs = OUTPUTS | STATE_OUTPUTS
        client = RtdeClient(clock, self.host, self.port, outputs, self.rate)
        try:
            await client.connect()
            self._check_controller(client)
            state = (await receive_states(client))[-1]
            yield Finding(client.endpoint, f"controller of version {client.controller}")
            for problem in filter(None, (state.stopped, state.slowed)):
                yield Finding(client.endpoint, f"{problem}: see the teach pendant", "note")
            stamps, end = np.zeros(0), clock.now() + DIAGNOSIS
            while clock.now() < end:
                stamps = np.append(stamps, (await client.receive())[1]["timestamp"])
        finally:
            await client.close()
        remedy = "check the network, and that no other program loads the controller"
        yield rate_finding(client.endpoint, np.rint(stamps * s).astype(np.int64), self.rate, remedy)

    def describe(self) -> Description:
        """Return arm, address, rate, controller version, and the number of its messages so far."""
        return self._about

    def _check_controller(self, client: RtdeClient) -> None:
        """Check the controller's software version, and add it to the description."""
        if int(client.controller.partition(".")[0]) <= CB3 and not _divides(self.rate, CB3_RATE):
            limit = f"sends {CB3_RATE} Hz at most, or {CB3_RATE} Hz divided by an integer"
            reason = f"a controller of version {client.controller} {limit}, not {self.rate}"
            raise EndpointError(client.endpoint, reason)
        self._about["controller"] = client.controller


def _decode(endpoint: str, arrivals: Times, rows: Rows) -> Motion:
    stamps: list[float] = rows["timestamp"].tolist()  # s; for a few rows, Python is faster than numpy
    if not all(0 <= stamp < _MAX_UPTIME for stamp in stamps):
        raise EndpointError(endpoint, f"sent timestamps {stamps} s, must be 0 to {_MAX_UPTIME:g} s")
    device_time = np.array([round(stamp * s) for stamp in stamps])
    velocity, pose = (rows[name].astype(np.float64) for name in ("actual_TCP_speed", "actual_TCP_pose"))
    return Motion.rows(arrivals, device_time, velocity, pose)


def _divides(rate: float, highest: float) -> bool:
    """Return True if `highest` is an integer multiple of `rate` (Hz), so that packages are periodic."""
    return isclose(highest / rate, round(highest / rate), abs_tol=1e-9)
