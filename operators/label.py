"""Slip labels from the arm's motion."""

from dataclasses import dataclass, field
from math import hypot, inf, isfinite, isnan
from typing import Any, Final

import numpy as np

from operators.batch import (
    SLIP,
    STATIC,
    UNKNOWN,
    Codes,
    Labelled,
    Reals,
    Sample,
    constant,
    ms,
)
from operators.checks import check_at_least
from operators.errors import ParameterError
from operators.operator import Operator
from operators.rotation import Real, Vector, quaternion, rotate, square_root
from operators.tail import Tail

_AXES: Final = 3
_LABELS: Final = {label: constant([label], np.int8) for label in (SLIP, STATIC, UNKNOWN)}  # (1,) each


@dataclass
class Label(Operator[Sample, Labelled]):
    """Label each sample as slip, static or unknown by the arm's speed in the contact plane.

    A sample is slip if the planar speed is above `speed` or, if `rotation` is given, the angular speed is
    above it. It is unknown if the planar speed is `limit` or more, or the motion is NaN, as in unmatched
    rows. The contact plane is perpendicular to `normal`. Without a known pose, the fingertip is assumed to
    be aligned with the base frame.

    `delay` compensates for arm velocity that lags the barometers: the motion at ``t + delay`` labels the
    touch at t. A positive delay holds samples back until that motion has arrived or the stream ends. Speed
    and label are shifted; velocity and pose remain those of t.

    Args:
        speed: Planar speed above which a sample is slip, m/s.
        limit: Planar speed from which a sample is unknown, m/s.
        rotation: Angular speed above which a sample is slip, rad/s; 0.2 in the paper; None: ignore rotation.
        normal: Normal of the contact plane in the fingertip's frame, of any length.
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
    normal: tuple[float, ...] = (0.0, 0.0, 1.0)
    delay: int = 0
    within: int = 20 * ms
    _unit: Vector[float] = field(default=(0.0, 0.0, 1.0), init=False, repr=False)
    # samples labelled by the motion at their own time
    _tail: Tail[Labelled] = field(
        default_factory=lambda: Tail(Labelled), init=False, repr=False, compare=False
    )
    _held: int = field(
        default=0, init=False, repr=False
    )  # number of newest rows of the tail that are held back

    def __post_init__(self) -> None:
        if not 0 <= self.speed < self.limit:
            raise ParameterError("Label", "speed", self.speed, f"from 0 to below limit, {self.limit:g} m/s")
        if self.rotation is not None:
            check_at_least("Label", "rotation", self.rotation, 0, "rad/s")
        check_at_least("Label", "within", self.within, 0, "ns")
        length = hypot(*self.normal)
        if len(self.normal) != _AXES or not 0 < length < inf:
            raise ParameterError("Label", "normal", self.normal, "three finite numbers, not all 0")
        x, y, z = self.normal
        self._unit = (x / length, y / length, z / length)

    def process(self, batch: Sample) -> Labelled:
        """Return the labelled batch, or the delayed samples that it completes."""
        labelled = self._label(batch)
        if self.delay == 0:
            return labelled
        tail = self._tail
        tail.append(labelled)
        self._held += len(batch)
        newest, held = batch.time.item(-1), tail.stop - self._held
        result = self._release(int(tail.block.time[held : tail.stop].searchsorted(newest - self.delay)))
        oldest = newest + min(self.delay, 0) - self.within  # ns, oldest motion still needed
        tail.drop(min(int(tail.time.searchsorted(oldest)), len(tail) - self._held))
        return result

    def flush(self) -> Labelled:
        """Return the delayed samples, labelled by the motion so far."""
        return self._release(self._held)

    def _release(self, count: int) -> Labelled:
        if not count:
            return Labelled.empty()
        tail, time = self._tail, self._tail.time
        held = tail.stop - self._held
        rows = tail.block[held : held + count]
        self._held -= count
        instant = rows.time + self.delay  # (n,)
        source = time.searchsorted(instant, "right") - 1  # (n,) -1: none
        known = (source >= 0) & (instant - time[source] <= self.within)
        source += tail.start
        speed = np.where(known, tail.block.speed[source], np.nan)
        label = np.where(known, tail.block.label[source], np.int8(UNKNOWN))
        return _labelled(rows, speed, label)

    def _label(self, batch: Sample) -> Labelled:
        if batch.time.size == 1:
            [(_, _, _, x, y, z)], [(u, v, w, a, b, c)] = batch.pose.tolist(), batch.velocity.tolist()
            posed = isfinite(x) and isfinite(y) and isfinite(z)
            speed = _planar_speed(
                (u, v, w), rotate(self._unit, quaternion((x, y, z))) if posed else self._unit
            )
            slip, known = speed > self.speed, speed < self.limit
            if self.rotation is not None:
                angular = square_root(a * a + b * b + c * c)
                slip, known = slip or angular > self.rotation, known and not isnan(angular)
            label = (SLIP if slip else STATIC) if known else UNKNOWN
            return _labelled(batch, np.array([speed]), _LABELS[label])
        turned = batch.pose[:, 3:]  # (n, 3)
        finite = np.isfinite(turned)
        velocity = batch.velocity.T  # (6, n)
        with np.errstate(over="ignore", invalid="ignore"):
            normal: Vector[Any] = self._unit
            if finite.any():
                turned = np.where(np.all(finite, axis=1)[:, None], turned, 0.0)
                normal = rotate(self._unit, quaternion((turned[:, 0], turned[:, 1], turned[:, 2])))
            speeds = _planar_speed((velocity[0], velocity[1], velocity[2]), normal)  # (n,)
            slips, knowns = speeds > self.speed, speeds < self.limit
            if self.rotation is not None:
                angulars = square_root(
                    velocity[3] * velocity[3] + velocity[4] * velocity[4] + velocity[5] * velocity[5]
                )
                slips, knowns = slips | (angulars > self.rotation), knowns & ~np.isnan(angulars)
        labels = np.where(knowns, np.where(slips, SLIP, STATIC), UNKNOWN).astype(np.int8)
        return _labelled(batch, speeds, labels)


def _planar_speed(velocity: Vector[Real], normal: Vector[Real]) -> Real:
    """Return the length of the component of a velocity perpendicular to a unit normal."""
    u, v, w = velocity
    x, y, z = normal
    a, b, c = y * w - z * v, z * u - x * w, x * v - y * u
    return square_root(a * a + b * b + c * c)


def _labelled(rows: Sample, speed: Reals, label: Codes) -> Labelled:
    return Labelled(
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
