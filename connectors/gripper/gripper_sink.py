"""A Robotiq 3-finger gripper as a sink: a flow commands with what force it grips."""

import asyncio
import logging
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from connectors.gripper.drive import GripperDrive, Wanted
from connectors.gripper.grip_force import ForceScale
from connectors.gripper.modbus_link import GripperLink
from connectors.gripper.robotiq import FULL, PORT, UNIT, Mode, Request, Status
from operators.batch import Commands
from operators.errors import EndpointError, FlowError, ParameterError
from operators.ports import Description, Run, Sink

log = logging.getLogger("slipflow")

FIRST_RETRY: Final = 0.1  # s
LAST_RETRY: Final = 2.0  # s, up to which the back-off doubles


@dataclass(eq=False)
class Gripper(Sink[Commands]):
    """Grips with the force that is commanded; the newest command wins.

    Opening it activates a gripper that is not active, which moves its fingers, and resets one with a fault.
    They go to `position` once a force is commanded, or at once if one is given, and stop at what they meet.
    Closing it leaves them as they are: what they hold is held. A recording moves nothing: with this sink no
    replay begins, paced or not.

    A command is obeyed when it comes, whatever its time. One with no force (NaN) changes nothing, and nor do
    velocities. A force beyond `limits` is brought to the nearer one, so that a controller that asks for too
    much gets as much as there is. A force that is lower than the one before may not loosen the grip: fingers
    that have stopped move again when more is asked for, or in the other direction.

    The gripper is looked at every `poll` seconds. One that has restarted is activated again, and grips again.
    When it fails, silent, lost or with a fault, it is tried again with back-off, `write` raises meanwhile,
    and the newest command is sent once it is back. A fault that only a reset ends is for people to look at:
    nothing is reset during a run.

    Args:
        limits: Of the force, N.
        force: N, to grip with from the beginning; None: not before it is commanded.
        mode: How the fingers stand to each other.
        position: Where they are to go, 0 open to 255 closed.
        speed: How fast, 0 to 255.
        scale: What the gripper's force register means.
        patience: Seconds for a connection, for each answer, and until a request is echoed.
        activation: Seconds until it is ready.
        poll: Seconds from look to look.

    Raises:
        ParameterError: on a value that cannot be used.

    >>> Gripper("10.0.0.3", limits=(15, 40)).destination
    'modbus://10.0.0.3:502/2'
    """

    host: str
    port: int = PORT
    unit: int = UNIT  # some grippers are set to 0 or 9
    limits: tuple[float, float] = (15.0, 60.0)
    force: float | None = None
    mode: Mode = Mode.BASIC
    position: int = FULL
    speed: int = FULL
    scale: ForceScale = field(default_factory=ForceScale)
    patience: float = 1.0
    activation: float = 30.0
    poll: float = 0.1

    lossless = False  # the newest command is what counts

    def __post_init__(self) -> None:
        if not self.host:
            raise ParameterError("Gripper", "host", self.host, "the address of a gripper")
        for name, highest in (("port", 65535), ("unit", FULL), ("position", FULL), ("speed", FULL)):
            if not (isinstance(value := getattr(self, name), int) and 0 <= value <= highest):
                raise ParameterError("Gripper", name, value, f"a whole number from 0 to {highest}")
        for name in ("patience", "activation", "poll"):
            if not (value := getattr(self, name)) > 0:
                raise ParameterError("Gripper", name, value, "above 0 s")
        low, high = self.limits
        if not self.scale.weakest <= low <= high <= self.scale.strongest:
            must_be = f"two forces that rise, from {self.scale.weakest} to {self.scale.strongest} N"
            raise ParameterError("Gripper", "limits", self.limits, must_be)
        if self.force is not None and not low <= self.force <= high:
            raise ParameterError("Gripper", "force", self.force, f"from {low} to {high} N")
        names = ["taken", "superseded", "limited", "sent", "restarts", "failures"]
        self._counted = dict.fromkeys(names, 0)
        self._begin()

    def _begin(self) -> None:
        """Be as before a run."""
        request = Request(active=True, mode=self.mode, position=self.position, speed=self.speed)
        if self.force is not None:
            request = replace(request, go=True, force=self.scale.register(self.force))
        self._wanted = Wanted(request)
        self._known = False  # it was ready when it was last heard of
        self._batch: Commands | None = None  # the newest that was taken
        self._drive: GripperDrive | None = None
        self._failure = ""
        self._serving: asyncio.Task[None] | None = None  # None: it is not open

    @property
    def destination(self) -> str:
        """Its address and unit."""
        return f"modbus://{self.host}:{self.port}/{self.unit}"

    @property
    def status(self) -> Status | None:
        """What it said last, once it had taken the newest request; None while it is out of reach."""
        return self._drive.status if self._drive else None

    def describe(self) -> Description:
        """Gripper, address, limits; what it is asked for, what it last said, and what was counted.

        Commands with a force are ``taken``; of these some are ``superseded`` by a newer one before they were
        sent, others ``limited``. Requests are ``sent``, activations among them. ``restarts`` and ``failures``
        are the gripper's.
        """
        status, wanted = self.status, self._wanted.request
        return {
            "gripper": "Robotiq 3-finger",
            "address": self.destination,
            "mode": self.mode.name.lower(),
            "limits_n": list(self.limits),
            "scale": [list(point) for point in self.scale.points],
            "force_n": self.scale.force(wanted.force) if wanted.go else None,
            "object_detected": status.object_detected if status else None,
            "fault": self._failure or (status.reason if status else ""),
            "positions": list(status.positions) if status else None,
            "counted": {**self._counted},
        }

    async def open(self, run: Run) -> None:
        """Connect, and activate it if need be.

        Raises:
            FlowError: in a replay.
            EndpointError: if it is out of reach, or cannot be activated.
            InputError: if pymodbus is not installed.
        """
        if run.recording is not None or not run.live:
            reason = "a replay moves no gripper: leave this sink out, or run the flow live"
            raise FlowError(run.flow, self.destination, reason)
        self._begin()
        try:
            drive = await self._connect()
            await drive.reset()
            while not drive.ready or drive.pending:
                await drive.turn()
        except BaseException:
            self._drop()
            raise
        self._serving = asyncio.create_task(self._serve())

    async def write(self, batch: Commands) -> None:
        """Take the newest force of a batch, to be sent at once.

        Raises:
            EndpointError: while the gripper fails; the newest force is kept, and sent once it is back.
        """
        if self._serving and self._serving.done():
            self._serving.result()  # raises
        if batch is not self._batch:  # else it is written again
            self._batch = batch
            self._take(batch)
        if self._failure:
            raise EndpointError(self.destination, self._failure)

    async def close(self) -> None:
        """Send the newest command, if that is not done, and leave; the fingers stay as they are.

        Raises:
            EndpointError: if the newest command cannot be sent.
        """
        if self._serving is None:
            return
        serving, self._serving = self._serving, None
        serving.cancel()
        await asyncio.wait({serving})
        try:
            async with asyncio.timeout(self.patience):
                while self._drive and not self._wanted.sent:
                    await self._drive.turn()
        except TimeoutError:
            self._failure = "is not ready to take the newest command"
        finally:
            self._drop()
        if not self._wanted.sent:
            raise EndpointError(self.destination, self._failure)

    def _take(self, batch: Commands) -> None:
        forces = batch.force[~np.isnan(batch.force)]
        if not len(forces):
            return
        low, high = self.limits
        newest = float(forces[-1])
        self._counted["taken"] += len(forces)
        self._counted["superseded"] += len(forces) - 1 + (not self._wanted.sent)
        self._counted["limited"] += not low <= newest <= high
        self._wanted.grip(self.scale.register(min(max(newest, low), high)))

    async def _serve(self) -> None:
        """Keep the gripper as it is wanted, for ever."""
        retry = FIRST_RETRY
        while True:
            try:
                drive = self._drive or await self._connect()
                await drive.turn()
            except EndpointError as error:
                self._drop()
                if not self._failure:
                    log.warning("%s, trying again", error)
                self._failure = error.reason
                self._counted["failures"] += 1
                await asyncio.sleep(retry)
                retry = min(2 * retry, LAST_RETRY)
            else:
                if drive.ready and self._failure:
                    log.warning("%s is back", self.destination)
                    self._failure, retry = "", FIRST_RETRY

    async def _connect(self) -> GripperDrive:
        link = GripperLink(self.destination, self.host, self.port, self.unit, self.patience)
        limits = {"patience": self.patience, "activation": self.activation, "poll": self.poll}
        self._drive = GripperDrive(link, self._wanted, self._counted, known=self._known, **limits)
        await link.connect()
        return self._drive

    def _drop(self) -> None:
        if self._drive:
            self._drive.link.close()
            self._known, self._drive = self._drive.known, None
