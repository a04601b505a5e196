"""UR arm that executes one move at a time and checks every state that its controller sends.

Commands go to a separate process (`control_process`). The arm is stopped if the controller stops, a bound is
violated, a move takes too long, the process dies or hangs, or the caller requests it. There are three
independent stops: the command to the process; `stop` over the dashboard, if the arm does not come to rest in
time or the process has died; and the controller's watchdog, which ends the control script when the process is
silent.
"""

import asyncio
import logging
from collections.abc import AsyncGenerator, Callable, Coroutine, Sequence
from contextlib import asynccontextmanager, suppress
from math import hypot, inf, isfinite, isnan
from typing import Any, Final, Self

from connectors.ur.control_process import START_TIMEOUT, WATCHDOG, ControlClient, Move, MoveTo, Signal
from connectors.ur.path_follower import PathFollower
from connectors.ur.ur_state import ArmState, Bounds, Point, Pose, receive_states, state_client
from operators.errors import EndpointError, os_error_reason
from operators.ports import Clock
from operators.rotation import quaternion, rotate
from storage.background_task import BackgroundTask

log = logging.getLogger("slipflow")

DASHBOARD: Final = 29999  # port
DASHBOARD_TIMEOUT: Final = 1.0  # s, for the whole exchange
STOP_TIMEOUT: Final = 1.0  # s, for the arm to come to rest
PATH_TOLERANCE: Final = 0.005  # m
_STEERING: Final = 0.02  # s between commands along a polyline
_REST: Final[Pose] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class UrArm:
    """Arm that can be moved while its context is open; leaving the context stops it.

    Every method that moves it or waits raises an EndpointError if it had to be stopped.

    Args:
        host: Address of the controller.
        bounds: Workspace and force limit.
        clock: Clock of the run.
        watchdog: Minimum rate of writes that the controller requires, else it stops the arm, Hz.
        path_tolerance: Deviation from a polyline at which the arm is stopped, m.

    Attributes:
        state: Newest state.
        fault: Reason why the arm was stopped; empty if it was not.
        control: Client of the process that commands the arm.
    """

    def __init__(
        self,
        host: str,
        bounds: Bounds,
        clock: Clock,
        *,
        watchdog: float = WATCHDOG,
        path_tolerance: float = PATH_TOLERANCE,
    ) -> None:
        self.host, self.bounds, self.fault = host, bounds, ""
        self.state = ArmState(_REST, _REST)
        self.control = ControlClient(host, watchdog, self.fail)
        self._endpoint, self._path_tolerance = f"ur://{host}", path_tolerance
        self._client = state_client(clock, host)
        self._state_known = True  # the controller sends the state
        self._changed = asyncio.Event()
        self._guard: Callable[[ArmState], str] | None = None  # returns why to stop the current move
        self._moved = 0.0  # loop time (s) at which the arm last moved
        self._tasks = list[BackgroundTask]()

    async def __aenter__(self) -> Self:
        """Connect to the controller, and start the process that commands the arm.

        Raises:
            EndpointError: if the controller sends no state, or the arm must not move or cannot be commanded.
        """
        try:
            await self._client.connect()
            self.state = (await receive_states(self._client))[-1]
            self.fault = self.fault or self.bounds.violation(self.state)
            self._check()
            if isfinite(self.bounds.force) and isnan(hypot(*self.state.force)):
                log.warning("%s: the controller reports no force: the limit is not checked", self._endpoint)
            if self.state.slowed:
                log.warning("%s: %s", self._endpoint, self.state.slowed)
            self._spawn("the reading of its state", self._read_states())
            self.control.start()
            self._spawn("the keep-alive of its control process", self.control.keep_alive())
            await self._until(lambda: self.control.ready, START_TIMEOUT, "to start")
        except BaseException:
            await self.__aexit__()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        """Stop the arm, and end the process and the connections."""
        if self.control.process and self.control.ready:
            await self.stop()
        await self.control.close()
        for task in self._tasks:
            await task.end()
        await self._client.close()

    async def line(self, poses: Sequence[Pose], speed: float, acceleration: float, seconds: float) -> None:
        """Move along straight lines through poses, and stop at the last; `seconds` is the planned duration.

        Through several poses it moves at constant speed and orientation.
        """
        for pose in poses:
            if reason := self.bounds.violation(ArmState(pose, _REST)):
                self.fail(f"target outside the bounds: {reason}")
        self._check()
        if len(poses) > 1:
            await self._trace([pose[:3] for pose in poses], speed, acceleration, 2 * seconds + 2)
            return
        self._moved = asyncio.get_running_loop().time()
        try:
            self.control.send(MoveTo(poses[0], speed, acceleration))
            await self._until(
                lambda: self._at(poses[0], speed, acceleration), 2 * seconds + 2, "to reach the target"
            )
        except asyncio.CancelledError:
            self.control.send(Signal.STOP)
            raise

    async def turn(self, spin: float, seconds: float, acceleration: float) -> None:
        """Rotate about the TCP's own z (rad/s) for a time (s), then come to rest."""
        self._check()
        velocity = rotate((0.0, 0.0, spin), quaternion(self.state.pose[3:]))
        async with self._velocity_control(abs(spin), acceleration):
            self.control.send(Move((0.0, 0.0, 0.0, *velocity), acceleration))
            await self.wait(seconds)

    async def _trace(
        self, points: Sequence[Point], speed: float, acceleration: float, longest: float
    ) -> None:
        """Steer along a polyline at constant speed and orientation."""
        loop = asyncio.get_running_loop()
        follower = PathFollower([self.state.pose[:3], *points], speed, acceleration)
        end = loop.time() + longest

        def deviates(state: ArmState) -> str:
            error = follower.deviation(state.pose[:3])
            return f"it is {1000 * error:.1f} mm off its path" if error > self._path_tolerance else ""

        async with self._velocity_control(speed, acceleration, deviates):
            while (velocity := follower.velocity(self.state.pose[:3])) is not None:
                if loop.time() > end:
                    self.fail(f"takes more than {longest:.1f} s to reach the target")
                    self._check()
                self.control.send(Move((*velocity, 0.0, 0.0, 0.0), acceleration))
                await self.wait(_STEERING)

    async def wait(self, seconds: float) -> None:
        """Wait while the arm continues its motion."""
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._until(lambda: False, inf, "")
        self._check()  # it may have been stopped as the time was up

    def fail(self, reason: str) -> None:
        """Stop the arm permanently; the current move and all later ones raise this reason."""
        if self.fault:
            return
        self.fault = reason
        self.control.send(Signal.STOP)
        log.error("%s is stopped: %s", self._endpoint, reason)
        self._changed.set()
        if self.control.process:
            self._spawn("the stop", self.stop())

    async def stop(self) -> None:
        """Stop the arm by all available stops; return when it stands or all stops were tried."""
        self.control.send(Signal.STOP)
        if self.control.ended.is_set() or not await self._stands():
            await self._stop_by_dashboard()
            if not await self._stands():
                log.error("%s may still move: press its emergency stop", self._endpoint)
                return
        self.control.send(Signal.RELEASE)

    @asynccontextmanager
    async def _velocity_control(
        self, speed: float, acceleration: float, guard: Callable[[ArmState], str] | None = None
    ) -> AsyncGenerator[None]:
        """Run a block that commands velocities (at most `speed`, m/s or rad/s), then bring the arm to rest.

        Until then, `guard` checks every state, and returns why the arm must be stopped, or an empty text.
        """
        self._guard = guard
        try:
            yield
            self.control.send(Move(_REST, acceleration))
            await self._until(lambda: self.state.still, 2 * speed / acceleration + 2, "to come to rest")
        except asyncio.CancelledError:
            self.control.send(Signal.STOP)
            raise
        finally:
            self._guard = None
        self.control.send(Signal.RELEASE)

    def _spawn(self, purpose: str, work: Coroutine[Any, Any, None]) -> None:
        """Start a background task; its failure stops the arm."""
        task = BackgroundTask(self._endpoint, purpose, work, self.fail, endless=False)
        self._tasks.append(task)

    async def _read_states(self) -> None:
        """Check each state."""
        try:
            while True:
                for state in await receive_states(self._client):
                    self.state = state
                    if reason := self.bounds.violation(state) or (self._guard(state) if self._guard else ""):
                        self.fail(reason)
                self._changed.set()
        except EndpointError as error:
            self._state_known = False
            self.fail(f"its state is unknown: {error.reason}")

    def _check(self) -> None:
        if self.fault:
            raise EndpointError(self._endpoint, self.fault)

    async def _until(self, done: Callable[[], bool], seconds: float, purpose: str) -> None:
        """Wait for a condition, checked at every state; stop the arm if it takes too long."""
        loop = asyncio.get_running_loop()
        end = loop.time() + seconds
        while True:
            self._check()
            if done():
                return
            self._changed.clear()
            try:
                async with asyncio.timeout(None if seconds == inf else end - loop.time()):
                    await self._changed.wait()
            except TimeoutError:
                self.fail(f"takes more than {seconds:.1f} s {purpose}")

    def _at(self, pose: Pose, speed: float, acceleration: float) -> bool:
        """Return True if the arm stands at a pose; repeat the command if it stands elsewhere."""
        now = asyncio.get_running_loop().time()
        if self.state.stands_at(pose):
            return True
        if not self.state.still:
            self._moved = now
        elif now - self._moved > STOP_TIMEOUT:
            self._moved = now
            self.control.send(MoveTo(pose, speed, acceleration))
        return False

    async def _stands(self) -> bool:
        """Return True if the arm is observed at rest within `STOP_TIMEOUT`."""
        try:
            async with asyncio.timeout(STOP_TIMEOUT):
                while True:
                    self._changed.clear()
                    await self._changed.wait()
                    if self._state_known and self.state.still:
                        return True
        except TimeoutError:
            return False

    async def _stop_by_dashboard(self) -> None:
        try:
            async with asyncio.timeout(DASHBOARD_TIMEOUT):
                answer = await request_stop(self.host)
        except (OSError, ValueError) as error:  # TimeoutError is an OSError
            reason = os_error_reason(error) if isinstance(error, OSError) else str(error)
            log.error("%s: cannot be stopped over the dashboard: %s", self._endpoint, reason)  # noqa: TRY400
        else:
            log.warning("%s: sent stop over the dashboard; answer: %s", self._endpoint, answer)


async def request_stop(host: str, port: int = DASHBOARD) -> str:
    """Stop the program of an arm by its dashboard, which is independent of the program; return the answer.

    Source: Universal Robots, "Dashboard Server".

    Raises:
        OSError: if the dashboard cannot be reached.
        ValueError: if it sends a line without an end, or closes the connection without an answer.
    """
    reader, writer = await asyncio.open_connection(host, port)
    try:
        await reader.readline()  # its greeting
        writer.write(b"stop\n")
        if answer := await reader.readline():
            return answer.decode("utf-8", "replace").strip()
        raise ValueError("closed the connection without an answer")
    finally:
        writer.close()
