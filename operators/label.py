"""What the arm's motion says of the fingertip: slip or static."""

from dataclasses import dataclass, field
from math import hypot, inf, isfinite, isnan
from typing import Any, Final

import numpy as np

from operators.batch import SLIP, STATIC, UNKNOWN, Codes, Labelled, Reals, Sample, constant, maker, ms
from operators.errors import ParameterError
from operators.operator import Operator
from operators.rotation import Real, Vector, quaternion, root, turn
from operators.tail import Tail

_AXES: Final = 3
_made: Final = maker(Labelled)
_LABELS: Final = {label: constant([label], np.int8) for label in (SLIP, STATIC, UNKNOWN)}  # (1,) each


@dataclass
class Label(Operator[Sample, Labelled]):
    """Label each sample by the planar speed of the arm, as the paper does (its section IV).

    Slip is a speed above `speed` in the contact plane or, if `rotation` is given, an angular speed above
    it; unknown is a planar speed of `limit` or more, or a motion that is NaN, as unmatched rows have it.
    The plane stands across `normal`, which is fixed to the fingertip; where the pose is unknown, so is how
    the fingertip is turned, and it is taken to be aligned with the base frame.

    The velocity may come early or late against the barometers. With a `delay` the motion at ``t + delay``
    labels the touch at t: that of the last sample up to then, and at most `within` before then. A positive
    delay holds samples back until a newer one than that has come, or the stream ends. Speed and label are
    shifted so; velocity and pose stay those of t.

    Raises:
        ParameterError: on a value that cannot be used.
    """

    speed: float = 0.003  # m/s
    limit: float = 0.3  # m/s
    rotation: float | None = None  # rad/s; 0.2 in the paper; None: translation alone counts
    normal: tuple[float, ...] = (0.0, 0.0, 1.0)  # in the fingertip's frame, of any length
    delay: int = 0  # ns
    within: int = 20 * ms
    _unit: Vector[float] = field(default=(0.0, 0.0, 1.0), init=False, repr=False)
    # labelled by their own motion
    _tail: Tail[Labelled] = field(
        default_factory=lambda: Tail(Labelled), init=False, repr=False, compare=False
    )
    _held: int = field(default=0, init=False, repr=False)  # of the tail, the newest rows, not yet given

    def __post_init__(self) -> None:
        if not 0 <= self.speed < self.limit:
            raise ParameterError(
                "Label", "speed", self.speed, f"from 0 to below the limit, {self.limit:g} m/s"
            )
        if self.rotation is not None and not self.rotation >= 0:
            raise ParameterError("Label", "rotation", self.rotation, "None, or at least 0 rad/s")
        if self.within < 0:
            raise ParameterError("Label", "within", self.within, "at least 0 ns")
        length = hypot(*self.normal)
        if len(self.normal) != _AXES or not 0 < length < inf:
            raise ParameterError("Label", "normal", self.normal, "three finite numbers, not all 0")
        x, y, z = self.normal
        self._unit = (x / length, y / length, z / length)

    def process(self, batch: Sample) -> Labelled:
        """Label the batch, or what it decides of the samples held back."""
        labelled = self._own(batch)
        if self.delay == 0:
            return labelled
        tail = self._tail
        tail.append(labelled)
        self._held += len(batch)
        newest, held = batch.time.item(-1), tail.stop - self._held
        result = self._give(int(tail.block.time[held : tail.stop].searchsorted(newest - self.delay)))
        oldest = newest + min(self.delay, 0) - self.within  # that may still be asked for
        tail.drop(min(int(tail.time.searchsorted(oldest)), len(tail) - self._held))
        return result

    def flush(self) -> Labelled:
        """Give the samples held back, with what is known of their motion."""
        return self._give(self._held)

    def _give(self, count: int) -> Labelled:
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

    def _own(self, batch: Sample) -> Labelled:
        # each row by its own motion
        if batch.time.size == 1:
            [(_, _, _, x, y, z)], [(u, v, w, a, b, c)] = batch.pose.tolist(), batch.velocity.tolist()
            posed = isfinite(x) and isfinite(y) and isfinite(z)
            speed = _across((u, v, w), turn(self._unit, quaternion((x, y, z))) if posed else self._unit)
            slip, known = speed > self.speed, speed < self.limit
            if self.rotation is not None:
                angular = root(a * a + b * b + c * c)
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
                normal = turn(self._unit, quaternion((turned[:, 0], turned[:, 1], turned[:, 2])))
            speeds = _across((velocity[0], velocity[1], velocity[2]), normal)  # (n,)
            slips, knowns = speeds > self.speed, speeds < self.limit
            if self.rotation is not None:
                angulars = root(
                    velocity[3] * velocity[3] + velocity[4] * velocity[4] + velocity[5] * velocity[5]
                )
                slips, knowns = slips | (angulars > self.rotation), knowns & ~np.isnan(angulars)
        labels = np.where(knowns, np.where(slips, SLIP, STATIC), UNKNOWN).astype(np.int8)
        return _labelled(batch, speeds, labels)


def _across(velocity: Vector[Real], normal: Vector[Real]) -> Real:
    """The length of a velocity's part across a unit normal."""
    u, v, w = velocity
    x, y, z = normal
    a, b, c = y * w - z * v, z * u - x * w, x * v - y * u
    return root(a * a + b * b + c * c)


def _labelled(rows: Sample, speed: Reals, label: Codes) -> Labelled:
    return _made(
        rows.time,
        rows.counts,
        rows.temperature,
        rows.valid,
        rows.velocity,
        rows.pose,
        rows.matched,
        speed,
        label,
        rows.finger,
    )
