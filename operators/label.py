"""Slip labels from the arm's motion, and their masking without contact."""

from dataclasses import dataclass, field, replace
from math import isfinite, isnan, nan, sqrt

import numpy as np

from operators.batch import (
    SLIP,
    STATIC,
    UNKNOWN,
    Batch,
    Codes,
    Labelled,
    Reals,
    Sample,
    Times,
    column,
    ms,
)
from operators.checks import check_at_least, check_ns
from operators.errors import ParameterError
from operators.operator import Operator
from operators.rotation import quaternion, rotate
from operators.row_loop import Ints, row_loop
from operators.row_queues import END, Chain, Tail


class _Known(Batch):
    """Speed and label by the motion at `time`."""

    speed: Reals = column(np.float64)  # (n,)
    label: Codes = column(np.int8)  # (n,)


@dataclass
class Label(Operator[Sample, Labelled]):
    """Label each sample as slip, static or unknown by the arm's speed in the contact plane.

    A sample is slip if the planar speed is above `speed` or, if `rotation` is given, the angular speed is
    above it. It is unknown if the planar speed is `limit` or more, or the motion is NaN, as in unmatched
    rows. The contact plane is perpendicular to the fingertip's z axis. Without a known pose, the fingertip
    is assumed to be aligned with the base frame.

    `delay` compensates for arm velocity that lags the barometers: the motion at ``t + delay`` labels the
    touch at t. A positive delay holds samples back until that motion has arrived or the stream ends. Speed
    and label are shifted; velocity and pose remain those of t.

    Args:
        speed: Planar speed above which a sample is slip, m/s.
        limit: Planar speed from which a sample is unknown, m/s.
        rotation: Angular speed above which a sample is slip, rad/s; 0.2 in the paper; None: ignore rotation.
        delay: Lag of the arm's motion, ns.
        within: Largest age of the motion at ``t + delay``, ns.

    Raises:
        ParameterError: if a parameter is invalid.

    References:
        "Under Pressure" (2021), section IV.

    >>> cells, velocity = np.zeros((1, 6), np.int16), np.array([[0.01, 0, 0, 0, 0, 0]])
    >>> sample = Sample(np.zeros(1, int), cells, cells, cells == 0, velocity, 0 * velocity, np.ones(1, bool))
    >>> Label(speed=0.003).push(sample).label
    array([1], dtype=int8)
    """

    speed: float = 0.003
    limit: float = 0.3
    rotation: float | None = None
    delay: int = 0
    within: int = 20 * ms
    _parameters: Reals = field(init=False, repr=False, compare=False)  # speed, limit, rotation
    # samples labelled by the motion at their own time
    _held: Chain[Labelled] = field(
        default_factory=lambda: Chain(Labelled), init=False, repr=False, compare=False
    )
    _known: "Tail[_Known]" = field(
        default_factory=lambda: Tail(_Known), init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        if not 0 <= self.speed < self.limit:
            raise ParameterError("Label", "speed", self.speed, f"from 0 to below limit, {self.limit:g} m/s")
        if self.rotation is not None:
            check_at_least("Label", "rotation", self.rotation, 0, "rad/s")
        check_ns("Label", "delay", self.delay)
        check_at_least("Label", "within", self.within, 0, "ns")
        rotation = nan if self.rotation is None else self.rotation
        self._parameters = np.array([self.speed, self.limit, rotation])

    def process(self, batch: Sample) -> Labelled:
        """Return the labelled batch, or the delayed samples that it completes."""
        speed, label = np.empty(batch.time.size), np.empty(batch.time.size, np.int8)
        _label(batch.velocity, batch.pose, self._parameters, speed, label)
        labelled = _labelled(batch, speed, label)
        if self.delay == 0:
            return labelled
        self._held.append(labelled)
        self._known.append(_Known(batch.time, speed, label))
        newest = batch.time.item(-1)
        result = self._release(newest - self.delay)
        oldest = newest + min(self.delay, 0) - self.within  # ns, oldest motion still needed
        self._known.drop(int(self._known.time.searchsorted(oldest)))
        return result

    def flush(self) -> Labelled:
        """Return the delayed samples, labelled by the motion so far."""
        return self._release(END)

    def _release(self, before: int) -> Labelled:
        rows, known = self._held.take(before), self._known
        if not rows.time.size:
            return rows
        block, speed, label = known.block, np.empty(rows.time.size), np.empty(rows.time.size, np.int8)
        limits = known.stop, self.delay, self.within
        _shift(rows.time, block.time, block.speed, block.label, limits, speed, label)
        return _labelled(rows, speed, label)


@dataclass
class MaskLifted(Operator[Labelled, Labelled]):
    """Replace slip labels by unknown while the fingertip is lifted off the surface.

    `Label` uses the arm's speed only. This operator masks slip where the TCP is more than `margin` above the
    contact plane. On a curved surface, that is the plane through its highest point: choose a margin that
    covers its height.

    Args:
        contact_pose: TCP pose at first contact, m and rotation vector; z points into the surface.
        margin: Tolerance above the contact plane, m.

    Raises:
        ParameterError: if the margin is below 0.

    >>> samples = Labelled.empty()
    >>> len(MaskLifted((0, 0, 0.1, 3.14, 0, 0)).push(samples))
    0
    """

    contact_pose: tuple[float, float, float, float, float, float]
    margin: float = 0.002

    def __post_init__(self) -> None:
        check_at_least("MaskLifted", "margin", self.margin, 0, "m")

    def process(self, batch: Labelled) -> Labelled:
        """Return the batch with masked labels."""
        x, y, z, *rotation = self.contact_pose
        u, v, w = rotate((0.0, 0.0, 1.0), quaternion((rotation[0], rotation[1], rotation[2])))
        pose = batch.pose  # (n, 6)
        # (n,) m below the contact plane; NaN: unknown
        depth = u * (pose[:, 0] - x) + v * (pose[:, 1] - y) + w * (pose[:, 2] - z)
        lifted = (depth < -self.margin) & (batch.label == SLIP)
        if not lifted.any():
            return batch
        return replace(batch, label=np.where(lifted, np.int8(UNKNOWN), batch.label))


@row_loop
def _label(velocity: Reals, pose: Reals, /, parameters: Reals, speeds: Reals, labels: Codes) -> None:
    speed, limit, rotation = float(parameters[0]), float(parameters[1]), float(parameters[2])
    for row in range(len(velocity)):
        normal = 0.0, 0.0, 1.0
        x, y, z = float(pose[row, 3]), float(pose[row, 4]), float(pose[row, 5])
        if isfinite(x) and isfinite(y) and isfinite(z):
            normal = rotate(normal, quaternion((x, y, z)))
        u, v, w = float(velocity[row, 0]), float(velocity[row, 1]), float(velocity[row, 2])
        x, y, z = normal
        planar = _length(y * w - z * v, z * u - x * w, x * v - y * u)
        slip, known = planar > speed, planar < limit
        if not isnan(rotation):
            angular = _length(float(velocity[row, 3]), float(velocity[row, 4]), float(velocity[row, 5]))
            slip, known = slip or angular > rotation, known and not isnan(angular)
        speeds[row] = planar
        labels[row] = (SLIP if slip else STATIC) if known else UNKNOWN


@row_loop
def _shift(
    time: Times, stamps: Times, speed: Reals, label: Codes, /, limits: Ints, speeds: Reals, labels: Codes
) -> None:
    """Label each row by the last one up to its time + delay, if that is within the limit."""
    stop, delay, within = limits
    after = stop  # index of the first stamp beyond the instant
    while after > 0 and stamps[after - 1] > time[0] + delay:
        after -= 1
    for row in range(len(time)):
        instant = time[row] + delay
        while after < stop and stamps[after] <= instant:
            after += 1
        known = after > 0 and instant - stamps[after - 1] <= within
        speeds[row] = speed[after - 1] if known else nan
        labels[row] = label[after - 1] if known else UNKNOWN


def _length(x: float, y: float, z: float) -> float:
    return sqrt(x * x + y * y + z * z)


def _labelled(rows: Sample, speed: Reals, label: Codes) -> Labelled:
    return Labelled(  # without *, which takes 0.2 us
        rows.time,
        rows.counts,
        rows.temperature,
        rows.valid,
        rows.velocity,
        rows.pose,
        rows.matched,
        speed,
        label,
        finger=rows.finger,
    )
