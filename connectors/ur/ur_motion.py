"""A UR arm's motion as a source, over RTDE: every package of the controller once, in order."""

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable
from dataclasses import dataclass, field
from math import isclose
from typing import Final, TypeVar, cast

import numpy as np

from connectors.ur.rtde import PORT, RtdeError
from connectors.ur.rtde_link import SILENT, STALLED, RtdeLink, mistyped, reason
from operators.batch import Flags, Motion, Times, s
from operators.errors import EndpointError, ParameterError
from operators.ports import Clock, Description, Json, Source

T = TypeVar("T")

OUTPUTS: Final = ("timestamp", "actual_TCP_pose", "actual_TCP_speed")
TYPES: Final = ("DOUBLE", "VECTOR6D", "VECTOR6D")
HIGHEST: Final = 500.0  # Hz, of an e-Series controller
CB3: Final = 3  # major version of the controllers before
CB3_HIGHEST: Final = 125.0  # Hz

_LONGEST: Final = 4e9  # s that a controller may have been up: 128 years
_ROW: Final = np.dtype([("recipe", "u1"), ("timestamp", ">f8"), ("pose", ">f8", 6), ("speed", ">f8", 6)])

log = logging.getLogger("slipflow")


@dataclass(eq=False)
class UrMotion(Source[Motion]):
    """What a UR controller reports of its tool centre point: pose and velocity in the base frame.

    `time` is when a package arrived, `device_time` the controller's own stamp, ns since it started: both raw.
    Packages that arrive together, as after a hold-up, have one arrival. `DeviceClock` puts the stream into
    the host's time, free of the way's jitter::

        motion = flow.source(UrMotion("10.0.0.2"))
        motion.to(dataset)  # as received
        samples = touch & (motion | DeviceClock()) | Align(within=20 * ms)

    A connection fails when the controller refuses, ends or resets it, when no package comes for `patience`
    (it stalls, or is gone without a farewell), and when its clock goes back (it restarted). A package with
    the stamp of the one before is that one again, and dropped.

    Raises:
        ParameterError: on a rate that no controller has, or a patience shorter than a package takes.
    """

    host: str
    rate: float = 125.0  # Hz; a CB3 controller has 125 at most, an e-Series one 500
    port: int = PORT
    patience: float = 1.0  # s, for a connection, its first package, and from package to package
    _about: dict[str, Json] = field(default_factory=dict[str, Json], init=False, repr=False)
    _stamps: "Stamps" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.host:
            raise ParameterError("UrMotion", "host", self.host, "the address of a controller")
        if not 0 < self.rate <= HIGHEST or _uneven(HIGHEST, self.rate):
            must_be = f"one of {HIGHEST:g} Hz, {HIGHEST / 2:g}, {HIGHEST / 3:.6g}, {HIGHEST / 4:g} and so on"
            raise ParameterError("UrMotion", "rate", self.rate, must_be)
        if not self.patience * self.rate > 1:
            raise ParameterError("UrMotion", "patience", self.patience, "longer than from package to package")
        self._stamps = Stamps(self.rate)
        self._about["arm"] = "UR"
        self._about.update(address=self._place, rate_hz=self.rate, controller=None, connections=0)
        self._note()

    @property
    def kind(self) -> type[Motion]:
        """What the arm's controller reports."""
        return Motion

    async def batches(self, clock: Clock) -> AsyncIterator[Motion]:
        """One connection's packages; those that wait to be taken as one batch.

        Raises:
            EndpointError: when the connection fails.
        """
        link, stamps = RtdeLink(clock, OUTPUTS, self.rate), self._stamps
        stamps.connect()
        try:
            connecting = asyncio.get_running_loop().create_connection(lambda: link, self.host, self.port)
            await self._patiently(connecting, SILENT)
            while True:
                arrivals, rows = await self._patiently(link.take(), STALLED)
                if stamps.first:
                    self._greet(link)
                motion = self._read(arrivals, rows)
                new = stamps.new(motion.device_time)
                self._note()
                if new.any():
                    yield motion[new]
                if stamps.back:
                    raise EndpointError(self._place, "its clock went back: the controller restarted")
        finally:
            await link.close()

    def describe(self) -> Description:
        """Arm, address and rate. It is alive: what is learnt of the controller and its stream is added."""
        return self._about

    def _greet(self, link: RtdeLink) -> None:
        """Note a connection that gives packages."""
        version, types = link.controller, link.types
        if types != TYPES:
            raise EndpointError(self._place, mistyped(OUTPUTS, types, TYPES))
        if version.major <= CB3 and (self.rate > CB3_HIGHEST or _uneven(CB3_HIGHEST, self.rate)):
            most = f"gives {CB3_HIGHEST} Hz at most, or a whole part of it"
            why = f"a controller of version {version} {most}, not {self.rate}"
            raise EndpointError(self._place, why)
        self._about["controller"] = str(version)
        self._about["connections"] = cast("int", self._about["connections"]) + 1

    def _note(self) -> None:
        stamps = self._stamps
        if stamps.missed != self._about.get("missed", 0) and not stamps.told:
            stamps.told = True  # once a connection
            log.warning("%s: packages are missing before %.3f s", self._place, stamps.newest / s)
        self._about.update(restarts=stamps.restarts, missed=stamps.missed, repeated=stamps.repeated)

    @property
    def _place(self) -> str:
        return f"rtde://{self.host}:{self.port}"

    def _read(self, arrivals: Times, packages: bytes) -> Motion:
        rows = np.frombuffer(packages, _ROW)
        stamps = rows["timestamp"].astype(np.float64)  # (n,) s
        if not ((stamps >= 0) & (stamps < _LONGEST)).all():
            raise EndpointError(
                self._place, f"sends the stamps {stamps.tolist()} s, must be from 0 to {_LONGEST:g} s"
            )
        device_time = np.rint(stamps * s).astype(np.int64)
        return Motion(
            arrivals, device_time, rows["speed"].astype(np.float64), rows["pose"].astype(np.float64)
        )

    async def _patiently(self, awaited: Awaitable[T], otherwise: str) -> T:
        """Wait for something of the controller's.

        Raises:
            EndpointError: if it fails, or does not come in time.
        """
        try:
            async with asyncio.timeout(self.patience):
                return await awaited
        except TimeoutError as error:
            raise EndpointError(self._place, otherwise.format(self.patience)) from error
        except (OSError, RtdeError) as error:
            raise EndpointError(self._place, reason(error)) from error


def _uneven(highest: float, rate: float) -> bool:
    """Whether a rate is no whole part of the highest: then packages would not come evenly."""
    return not isclose(highest / rate, round(highest / rate), abs_tol=1e-9)


@dataclass
class Stamps:
    """The controller's stamps: which packages are new, and how many did not come."""

    rate: float  # Hz
    newest: int = 0  # ns
    missed: int = 0
    repeated: int = 0
    restarts: int = 0
    back: bool = False  # this connection's clock went back
    told: bool = False  # that packages were missing in this connection
    first: bool = True  # the next one is the first of its connection

    def connect(self) -> None:
        """Packages come from another connection."""
        self.first, self.back, self.told = True, False, False

    def new(self, stamps: Times) -> Flags:
        """Which packages (n,), n at least 1, are new; none are from where their clock went back."""
        period = round(s / self.rate)
        first = stamps.item(0)
        if self.first:
            self.restarts += first < self.newest
            self.newest = first - period
        steps = np.diff(stamps, prepend=self.newest)  # (n,) ns
        intact = np.logical_and.accumulate(steps >= 0)  # (n,)
        new: Flags = intact & (steps > 0)
        self.back, self.first = not intact.all(), False
        self.repeated += int((intact & (steps == 0)).sum())
        self.missed += int(np.maximum(np.rint(steps[new] / period) - 1, 0).sum())
        self.newest = stamps[intact].max(initial=self.newest).item()
        return new
