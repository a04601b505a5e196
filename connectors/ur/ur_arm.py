"""A UR arm that is moved: one order at a time, watched at every package of its controller.

Orders go to a process of their own (`connectors.ur.control_process`). Whatever goes wrong stops the arm: a
stop of the controller's, a bound that is passed, an order that takes too long, a process that dies or
hangs, a caller that says so.
Three stops back each other up: the order to the process; if the arm does not stop soon,
or the process is gone, `stop` over the dashboard; and the controller's watchdog, which ends the program when
it does not hear of the process.
"""

import asyncio
import logging
from collections.abc import AsyncGenerator, Callable, Coroutine, Sequence
from contextlib import asynccontextmanager, suppress
from math import hypot, inf, isfinite, isnan
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from types import TracebackType
from typing import Any, Final, Self

from connectors.ur import dashboard_client as ur_dashboard
from connectors.ur.control_process import (
    WATCHDOG,
    Alive,
    End,
    Go,
    Line,
    Order,
    Rest,
    Stop,
    Vector,
    Word,
    serve,
)
from connectors.ur.course import Course, Place
from connectors.ur.probe import Probe, mean_force
from connectors.ur.ur_state import Bounds, State, Watch
from operators.errors import EndpointError
from operators.ports import Clock

log = logging.getLogger("slipflow")

BEGIN: Final = 30.0  # s, for the process to begin; it imports and uploads a program
STAND: Final = 1.0  # s, for the arm to come to rest
HUNG: Final = 2.0  # s without a word from the process
_TALK: Final = 0.1  # s from word to word to the process
_STEER: Final = 0.02  # s from order to order along a bent way
STRAY: Final = 0.005  # m


class UrArm:
    """An arm between `open` and `close`, or as a context; afterwards it stands.

    Args:
        host: Its controller.
        bounds: Where it may be, and how hard it may press.
        clock: Of the run.
        watchdog: Least rate at which the controller has to hear of us, Hz: it stops the arm otherwise.
        stray: How far it may get off a line of places, or beyond its end, before it is stopped, m.

    Attributes:
        state: The newest that the controller told.
        fault: Why it was stopped; empty: it was not.
        process: That commands it, while it is open.
    """

    def __init__(
        self, host: str, bounds: Bounds, clock: Clock, *, watchdog: float = WATCHDOG, stray: float = STRAY
    ) -> None:
        self.host, self.bounds, self.fault = host, bounds, ""
        self._place, self._watchdog, self._stray = f"ur://{host}", watchdog, stray
        self._watch = Watch(clock, host)
        self.state = State((0.0,) * 6, (0.0,) * 6)
        self._pipe: Connection | None = None
        self.process: SpawnProcess | None = None
        self._news, self._ready, self._gone = asyncio.Event(), False, asyncio.Event()
        self._closing = self._asked = False
        self._air: Place = (0.0, 0.0, 0.0)  # N, that is told though nothing is touched
        self._guard: Callable[[State], str] | None = None  # of the move at hand: why to stop
        self._told = True  # the controller still tells the state
        self._heard = 0.0  # s, of the loop, when the process last said something
        self._moved = 0.0  # s, of the loop, when it moved last
        self._tasks = set[asyncio.Task[None]]()

    async def open(self) -> None:
        """Connect to the controller, and begin the process that commands the arm.

        Raises:
            EndpointError: if the arm does not tell its state, may not move, or cannot be commanded.
        """
        try:
            self.state = await self._watch.open()
            self.fault = self.fault or self.bounds.breach(self.state)
            self._check()
            if isfinite(self.bounds.force) and isnan(hypot(*self.state.force)):
                log.warning("%s: the controller tells no force: its bound is not watched", self._place)
            self._begin(self._follow())
            self._start()
            self._begin(self._talk())
            await self._until(lambda: self._ready, BEGIN, "to begin")
        except BaseException:
            await self.close()
            raise

    async def line(self, pose: Vector, speed: float, acceleration: float, seconds: float) -> None:
        """Go straight to a pose and stop there, which is planned to take so many seconds.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        if why := self.bounds.breach(State(pose, (0.0,) * 6)):
            self.fail(f"not sent where {why}")
        self._check()
        self._moved = asyncio.get_running_loop().time()
        try:
            self._send(Line(pose, speed, acceleration))
            await self._until(lambda: self._there(pose, speed, acceleration), 2 * seconds + 2, "to get there")
        except asyncio.CancelledError:
            self._send(Stop())
            raise

    async def slide(self, velocity: Vector, seconds: float, acceleration: float) -> None:
        """Go on with a velocity for a time, then come to rest.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        self._check()
        async with self._gliding(max(map(abs, velocity)), acceleration):
            self._send(Go(velocity, acceleration))
            await self.wait(seconds)

    async def trace(self, places: Sequence[Place], speed: float, acceleration: float, seconds: float) -> None:
        """Go along a line of places at one speed, turned as it is, which is planned to take so many seconds.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        for place in places:
            if why := self.bounds.breach(State((*place, *self.state.pose[3:]), (0.0,) * 6)):
                self.fail(f"not sent where {why}")
        self._check()
        loop = asyncio.get_running_loop()
        course, end = Course([self._here, *places], speed, acceleration), loop.time() + 2 * seconds + 2

        def strays(state: State) -> str:
            off = course.off((state.pose[0], state.pose[1], state.pose[2]))
            return f"it is {1000 * off:.1f} mm off its way" if off > self._stray else ""

        async with self._gliding(speed, acceleration, strays):
            while (velocity := course.steer(self._here)) is not None:
                if loop.time() > end:
                    self.fail(f"takes more than {2 * seconds + 2:.1f} s to get there")
                self._send(Go((*velocity, 0.0, 0.0, 0.0), acceleration))
                await self.wait(_STEER)

    async def tare(self, seconds: float) -> None:
        """Stand still in the air, and take the force that is told meanwhile for none.

        Raises:
            EndpointError: if the arm had to be stopped, or its controller tells no force.
        """
        loop, told = asyncio.get_running_loop(), [self.state]
        end = loop.time() + seconds
        while loop.time() < end:
            await self.wait(_STEER)
            told.append(self.state)
        if (air := mean_force(told)) is None:
            self.fail("its controller tells no force, so contact cannot be felt")
            self._check()
        else:
            self._air = air

    async def touch(self, way: Place, force: float, speed: float, acceleration: float) -> float:
        """Go straight on, by a way (m) at most, until what is touched pushes back with a force (N).

        The force is what the controller tells beyond that of the last `tare`.

        Returns:
            The force where it stands.

        Raises:
            EndpointError: if the arm had to be stopped, as it is when the way ends without that force.
        """
        self._check()
        probe = Probe(self.state, way, force, self._air)
        x, y, z = (speed * each for each in probe.direction)
        async with self._gliding(speed, acceleration, probe.overruns):
            self._send(Go((x, y, z, 0.0, 0.0, 0.0), acceleration))
            longest = 2 * probe.longest / speed + 2
            await self._until(lambda: probe.look(self.state), longest, "to touch anything")
        if not probe.felt:
            far, push = 1000 * probe.longest, probe.push
            self.fail(f"no contact of {force:g} N within {far:.1f} mm: {push:.1f} N there")
            self._check()
        return probe.pushed(self.state)

    async def wait(self, seconds: float) -> None:
        """Go on as it is for a time.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._until(lambda: False, inf, "")

    def fail(self, why: str) -> None:
        """Stop the arm for good; whoever moves it is told why."""
        if self.fault:
            return
        self.fault = why
        self._send(Stop())
        log.error("%s is stopped: %s", self._place, why)
        self._news.set()
        if self.process:
            self._begin(self.stop())

    async def stop(self) -> None:
        """Come to rest, whatever it takes; returns when the arm stands, or nothing more can be done."""
        self._send(Stop())
        if self._gone.is_set() or not await self._stands():
            await self._stop_otherwise()
            if not await self._stands():
                log.error("%s may still move: press its emergency stop", self._place)
                return
        self._send(Rest())

    async def close(self) -> None:
        """Stop the arm, and end the process and the connections."""
        if process := self.process:
            if self._ready:
                await self.stop()
            self._closing = True
            self._send(End())
            with suppress(TimeoutError):
                async with asyncio.timeout(HUNG):
                    await self._gone.wait()
            self.process = None
            if not self._gone.is_set():
                process.kill()
            await asyncio.to_thread(process.join, HUNG)
            self._leave()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._watch.close()

    async def __aenter__(self) -> Self:
        await self.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    @property
    def _here(self) -> Place:
        x, y, z, *_ = self.state.pose
        return x, y, z

    @asynccontextmanager
    async def _gliding(
        self, speed: float, acceleration: float, guard: Callable[[State], str] | None = None
    ) -> AsyncGenerator[None]:
        """A block that moves by velocities (m/s or rad/s at most); it ends at rest.

        A guard looks at every state until then, and says why the arm has to be stopped.

        Raises:
            EndpointError: if the arm had to be stopped.
        """
        self._guard = guard
        try:
            yield
            self._send(Go((0.0, 0.0, 0.0, 0.0, 0.0, 0.0), acceleration))
            await self._until(lambda: self.state.still, 2 * speed / acceleration + 2, "to come to rest")
        except asyncio.CancelledError:
            self._send(Stop())
            raise
        finally:
            self._guard = None
        self._send(Rest())

    def _start(self) -> None:
        context = get_context("spawn")  # what a fork would inherit, an event loop and threads, is not for it
        self._pipe, theirs = context.Pipe()
        self.process = context.Process(
            target=serve, args=(theirs, self.host, self._watchdog), name=f"arm {self.host}", daemon=True
        )
        self.process.start()
        theirs.close()
        loop = asyncio.get_running_loop()
        self._heard = loop.time() + BEGIN
        loop.add_reader(self._pipe.fileno(), self._hear)

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _follow(self) -> None:
        """Look at each state."""
        try:
            while True:
                for state in await self._watch.next():
                    self.state = state
                    if why := self.bounds.breach(state) or (self._guard(state) if self._guard else ""):
                        self.fail(why)
                self._news.set()
        except EndpointError as error:
            self._told = False
            self.fail(f"its state is unknown: {error.reason}")

    async def _talk(self) -> None:
        """Tell the process that we are there, and see that it is."""
        loop = asyncio.get_running_loop()
        while not self._gone.is_set():
            self._send(Alive())
            if loop.time() - self._heard > HUNG:
                self.fail(f"the process that commands it says nothing for {HUNG} s")
            await asyncio.sleep(_TALK)

    def _hear(self) -> None:
        """Take the words of the process."""
        assert self._pipe
        try:
            while self._pipe.poll():
                word: Word = self._pipe.recv()
                self._heard = asyncio.get_running_loop().time()
                if word.kind == "ready":
                    self._ready = True
                    self._news.set()
                elif word.kind == "failed":
                    self.fail(word.text)
        except (EOFError, OSError):
            self._leave()
            if not self._closing:
                self.fail("the process that commands it died; the controller's watchdog stops the arm, too")

    def _leave(self) -> None:
        """The process is gone."""
        self._gone.set()
        if self._pipe:
            asyncio.get_running_loop().remove_reader(self._pipe.fileno())
            self._pipe.close()
            self._pipe = None

    def _send(self, order: Order) -> None:
        if self._pipe:
            with suppress(OSError):  # it is gone: `_hear` says so
                self._pipe.send(order)

    def _check(self) -> None:
        if self.fault:
            raise EndpointError(self._place, self.fault)

    async def _until(self, done: Callable[[], bool], seconds: float, what: str) -> None:
        """Wait for something of the arm's, at most so long.

        Raises:
            EndpointError: if it was stopped, or it takes too long: then it is stopped.
        """
        loop = asyncio.get_running_loop()
        end = loop.time() + seconds
        while True:
            self._check()
            if done():
                return
            self._news.clear()
            try:
                async with asyncio.timeout(None if seconds == inf else end - loop.time()):
                    await self._news.wait()
            except TimeoutError:
                self.fail(f"takes more than {seconds:.1f} s {what}")

    def _there(self, pose: Vector, speed: float, acceleration: float) -> bool:
        """Whether the arm is at a pose; one that stands short of it is sent there again."""
        now = asyncio.get_running_loop().time()
        if self.state.at(pose):
            return True
        if not self.state.still:
            self._moved = now
        elif now - self._moved > STAND:
            self._moved = now
            self._send(Line(pose, speed, acceleration))
        return False

    async def _stands(self) -> bool:
        """Whether the arm is told to stand, soon."""
        try:
            async with asyncio.timeout(STAND):
                while True:
                    self._news.clear()
                    await self._news.wait()
                    if self._told and self.state.still:
                        return True
        except TimeoutError:
            return False

    async def _stop_otherwise(self) -> None:
        if self._asked:
            return
        self._asked = True
        try:
            answer = await ur_dashboard.ask(self.host, "stop")
            log.warning("%s: asked over the dashboard to stop, it says: %s", self._place, answer)
        except EndpointError as error:
            log.error("%s: cannot be stopped over the dashboard: %s", self._place, error.reason)  # noqa: TRY400
