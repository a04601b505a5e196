"""Sink that sends force commands to a Robotiq 3-finger gripper."""

import asyncio
import logging
from collections.abc import AsyncGenerator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from connectors.gripper.drive import GripperDrive
from connectors.gripper.robotiq import (
    FULL,
    PORT,
    STRONGEST,
    UNIT,
    WEAKEST,
    Request,
    Status,
    force_register,
    register_force,
)
from operators.batch import Commands
from operators.checks import check_above, check_between
from operators.errors import EndpointError, FlowError, ParameterError
from operators.ports import BackOff, Clock, Description, Finding, Run, Sink
from storage.background_task import BackgroundTask

log = logging.getLogger("slipflow")

RETRY: Final = 2.0  # s, longest time between attempts to reconnect


@dataclass(eq=False)
class Gripper(Sink[Commands]):
    """Sink that sets the grip force of a Robotiq 3-finger gripper in its basic mode; the newest command wins.

    Opening activates an inactive gripper, which moves its fingers, and resets a fault. The fingers close with
    the first commanded force, or at once if `force` is given, and stop at an object. Closing the sink leaves
    them as they are. The sink refuses to start in a replay, paced or not.

    A command is executed on arrival, whatever its timestamp. A force of NaN and velocities have no effect. A
    force outside `limits` is clipped. A lower force may not loosen the grip: according to the manual, stopped
    fingers move again only for a higher force or another position.

    The status is read every 0.1 s. A restarted gripper is activated and grips again. A gripper that
    fails (silent, lost, or with a fault) is retried with back-off; meanwhile `write` raises, and the newest
    command is sent afterwards. Faults that need a reset are left to the user during a run.

    Source: Robotiq, "3-Finger Adaptive Robot Gripper Instruction Manual".

    Args:
        limits: Minimum and maximum force, N.
        force: Initial force, N; None: the first command sets the force.
        timeout: Longest wait for the connection, for each answer, and for the echo of a request, s.

    Raises:
        ParameterError: on an invalid value.

    >>> Gripper("10.0.0.3", limits=(15, 40)).destination
    'modbus://10.0.0.3:502/2'
    """

    host: str
    port: int = PORT
    unit: int = UNIT  # some grippers are set to 0 or 9
    limits: tuple[float, float] = (WEAKEST, STRONGEST)
    force: float | None = None
    timeout: float = 1.0

    extra = "gripper"
    lossless = False  # only the newest command matters

    def __post_init__(self) -> None:
        if not self.host:
            raise ParameterError("Gripper", "host", self.host, "the address of a gripper")
        for name, highest in (("port", 65535), ("unit", FULL)):
            if not (isinstance(value := getattr(self, name), int) and 0 <= value <= highest):
                raise ParameterError("Gripper", name, value, f"a whole number from 0 to {highest}")
        check_above("Gripper", "timeout", self.timeout, 0, "s")
        low, high = self.limits
        if not WEAKEST <= low <= high <= STRONGEST:
            must_be = f"two increasing forces from {WEAKEST} to {STRONGEST} N"
            raise ParameterError("Gripper", "limits", self.limits, must_be)
        if self.force is not None:
            check_between("Gripper", "force", self.force, low, high, unit="N")
        self._counted = dict.fromkeys(["taken", "limited", "sent", "restarts", "failures"], 0)
        self._reset()

    def _reset(self) -> None:
        """Set the state before a run."""
        target = Request(active=True, position=FULL, speed=FULL)
        if self.force is not None:
            target = replace(target, go=True, force=force_register(self.force))
        self._drive = self._new_drive(target)
        self._batch: Commands | None = None  # newest batch
        self._failure = ""
        self._serving: BackgroundTask | None = None  # None: not open

    @property
    def destination(self) -> str:
        """Address and unit of the gripper."""
        return f"modbus://{self.host}:{self.port}/{self.unit}"

    @property
    def status(self) -> Status | None:
        """Newest status after the newest request was echoed; None while the gripper cannot be reached."""
        return self._drive.status

    def describe(self) -> Description:
        """Return gripper, address, limits, target, newest status and counts.

        ``taken`` counts batches with a force; of these, ``limited`` were clipped. ``sent`` counts requests,
        including activations; ``restarts`` and ``failures`` count those of the gripper.
        """
        status, request = self.status, self._drive.target
        return {
            "gripper": "Robotiq 3-finger",
            "address": self.destination,
            "limits_n": list(self.limits),
            "force_n": register_force(request.force) if request.go else None,
            "object_detected": status.object_detected if status else None,
            "fault": self._failure or (status.reason if status else ""),
            "positions": list(status.positions) if status else None,
            "counted": {**self._counted},
        }

    async def diagnose(self, clock: Clock) -> AsyncGenerator[Finding]:  # noqa: ARG002 - needs none
        """Read the status of the gripper, without activating it.

        Raises:
            EndpointError: if the gripper cannot be reached.
            InputError: if pymodbus is not installed.
        """
        drive = self._new_drive(Request())
        try:
            await drive.connect()
            status = await drive.read_status()
        finally:
            drive.drop()
        if status.fault:
            text = f"{status.reason}: remove what obstructs it; the start of a run resets the fault"
            yield Finding(self.destination, text, "bad")
        elif not status.ready:
            text = "answers, not activated: the start of a run activates it, which moves its fingers"
            yield Finding(self.destination, text, "note")
        else:
            yield Finding(self.destination, f"ready, fingers at {status.positions} of {FULL}")

    async def open(self, run: Run) -> None:
        """Connect, and activate the gripper if needed.

        Raises:
            FlowError: in a replay.
            EndpointError: if the gripper cannot be reached or activated.
            InputError: if pymodbus is not installed.
        """
        if run.recording is not None or not run.live:
            reason = "a replay must not move a gripper: remove this sink, or run the flow live"
            raise FlowError(run.flow, self.destination, reason)
        self._reset()
        try:
            await self._drive.start()
        except BaseException:
            self._drive.drop()
            raise
        self._serving = BackgroundTask(self.destination, "the control of the gripper", self._serve())

    async def write(self, batch: Commands) -> None:
        """Send the newest force of a batch.

        Raises:
            EndpointError: while the gripper fails; the newest force is sent after it recovers.
        """
        if self._serving:
            self._serving.check()
        if batch is not self._batch:  # the runner retries a failed batch
            self._batch = batch
            self._take(batch)
        if self._failure:
            raise EndpointError(self.destination, self._failure)

    async def close(self) -> None:
        """Send the newest command if it has not been sent, and disconnect; the fingers stay as they are.

        Raises:
            EndpointError: if the newest command cannot be sent, or the background task has failed.
        """
        if self._serving is None:
            return
        serving, self._serving = self._serving, None
        await serving.end()
        try:
            async with asyncio.timeout(self.timeout):
                while self._drive.connected and self._drive.pending:
                    await self._drive.step()
            unsent = self._failure if self._drive.pending else ""
        except TimeoutError:
            unsent = "is not ready for the newest command"
        finally:
            self._drive.drop()
        serving.check()
        if unsent:
            raise EndpointError(self.destination, unsent)

    def _take(self, batch: Commands) -> None:
        forces = batch.force[~np.isnan(batch.force)]
        if not len(forces):
            return
        low, high = self.limits
        newest = float(forces[-1])
        self._counted["taken"] += 1
        self._counted["limited"] += not low <= newest <= high
        self._drive.grip(force_register(min(max(newest, low), high)))

    async def _serve(self) -> None:
        """Keep the gripper on target until cancelled."""
        back_off, drive = BackOff(last=RETRY), self._drive
        while True:
            try:
                await drive.step()
            except EndpointError as error:
                drive.drop()
                if not self._failure:
                    log.warning("%s, retrying", error)
                self._failure = error.reason
                self._counted["failures"] += 1
                await asyncio.sleep(back_off.delay())
            else:
                if drive.ready and self._failure:
                    log.warning("%s works again", self.destination)
                    self._failure = ""
                    back_off.reset()

    def _new_drive(self, target: Request) -> GripperDrive:
        address = self.host, self.port
        counted, timeout = self._counted, self.timeout
        return GripperDrive(self.destination, address, self.unit, target, counted=counted, timeout=timeout)
