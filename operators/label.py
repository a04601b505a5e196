"""Slip labels from the arm's motion, and their masking without contact."""

from dataclasses import dataclass
from math import inf, isfinite, isnan, nan, sqrt
from numbers import Real
from typing import Any, Final

import numpy as np

from operators.batch import SLIP, STATIC, UNKNOWN, Labelled, Sample, ms
from operators.checks import check_at_least, check_ns
from operators.errors import ParameterError
from operators.operator import Operator
from operators.rotation import quaternion, rotate
from operators.steps import Record, RowType, Steps, copy, queue

LIMIT: Final = 0.3  # m/s, planar speed from which a sample is unknown
WITHIN: Final = 20 * ms  # largest age of the motion that labels a sample
MARGIN: Final = 0.002  # m above the contact plane


@dataclass
class Label(Operator[Sample, Labelled]):
    """Label each sample as slip, static or unknown by the arm's speed in the contact plane.

    A sample is slip if the planar speed is above `speed` or the angular speed is above `rotation`. It is
    unknown if the planar speed is 0.3 m/s or more, or the motion is NaN, as in unmatched rows. The contact
    plane is perpendicular to the fingertip's z axis. Without a known pose, the fingertip is assumed to be
    aligned with the base frame.

    `delay` compensates for arm velocity that lags the barometers: the motion at ``t + delay`` labels the
    touch at t, unless it is older than 20 ms then. A positive delay holds samples back until that motion has
    arrived or the stream ends. Speed and label are shifted; velocity and pose remain those of t.

    Args:
        speed: Planar speed above which a sample is slip, m/s.
        rotation: Angular speed above which a sample is slip, rad/s, as in the paper; inf: ignore rotation.
        delay: Lag of the arm's motion, ns.

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
    rotation: float = 0.2
    delay: int = 0

    def __post_init__(self) -> None:
        check_at_least("Label", "speed", self.speed, 0, "m/s")
        if self.speed >= LIMIT:
            raise ParameterError("Label", "speed", self.speed, f"below {LIMIT:g} m/s")
        check_at_least("Label", "rotation", self.rotation, 0, "rad/s")
        check_ns("Label", "delay", self.delay)

    def steps(self, *given: RowType) -> Steps:
        """Return the step, or with a delay the functions that hold samples back."""
        settings = {"speed": float(self.speed), "rotation": float(self.rotation), "delay": self.delay}
        if not self.delay:
            return Steps(settings, step=_label)
        samples = queue(RowType(Labelled, given[0].cells), abs(self.delay) + WITHIN)
        state = {
            "samples": samples,  # labelled by the motion at their own time
            "first": 0,  # number of the oldest sample that waits
            "last": 0,  # number after the newest one
            "ended": 0,
        }
        return Steps(settings, state, takes=(_take_sample,), give=_give_delayed, held=len(samples))


@dataclass
class MaskLifted(Operator[Labelled, Labelled]):
    """Replace slip labels by unknown while the fingertip is lifted off the surface.

    `Label` uses the arm's speed only. This operator masks slip where the TCP is more than 2 mm above the
    contact plane. On a curved surface, give the pose at its highest point.

    Args:
        contact_pose: TCP pose at first contact, m and rotation vector; z points into the surface.

    Raises:
        ParameterError: if the pose is not six finite numbers.

    >>> samples = Labelled.empty()
    >>> len(MaskLifted((0, 0, 0.1, 3.14, 0, 0)).push(samples))
    0
    """

    contact_pose: tuple[float, float, float, float, float, float]

    def __post_init__(self) -> None:
        pose: Any = self.contact_pose
        numbers = [v for v in pose if isinstance(v, Real) and isfinite(v)] if np.iterable(pose) else []
        if len(numbers) != 6 or len(pose) != 6:
            must_be = "six finite numbers: position (m) and rotation vector (rad)"
            raise ParameterError("MaskLifted", "contact_pose", pose, must_be)

    def steps(self, *given: RowType) -> Steps:
        """Return the step."""
        x, y, z, *rotation = self.contact_pose
        normal = rotate((0.0, 0.0, 1.0), quaternion((rotation[0], rotation[1], rotation[2])))
        settings = {"contact": np.array([x, y, z], float), "normal": np.array(normal)}
        return Steps(settings, step=_mask)


def _label(settings: Record, state: Record, row: Record, out: Record) -> bool:
    copy(out, row)
    normal = 0.0, 0.0, 1.0
    x, y, z = float(row.pose[3]), float(row.pose[4]), float(row.pose[5])
    if isfinite(x) and isfinite(y) and isfinite(z):
        normal = rotate(normal, quaternion((x, y, z)))
    u, v, w = float(row.velocity[0]), float(row.velocity[1]), float(row.velocity[2])
    x, y, z = normal
    planar = _length(y * w - z * v, z * u - x * w, x * v - y * u)
    angular = _length(float(row.velocity[3]), float(row.velocity[4]), float(row.velocity[5]))
    out.speed = planar
    if planar < LIMIT and (settings.rotation == inf or not isnan(angular)):
        out.label = SLIP if planar > settings.speed or angular > settings.rotation else STATIC
    else:
        out.label = UNKNOWN
    return True


def _take_sample(settings: Record, state: Record, row: Record) -> None:
    """Label a sample by the motion at its own time, and keep it as motion for others."""
    _label(settings, state, row, state.samples[state.last % len(state.samples)])
    state.last += 1


def _give_delayed(settings: Record, state: Record, out: Record) -> bool:
    """Label the oldest sample that waits by the motion `delay` after it, if that has arrived."""
    if state.first == state.last:
        return False
    kept = len(state.samples)
    row, newest = state.samples[state.first % kept], state.samples[(state.last - 1) % kept].time
    full = state.last - state.first == kept
    if row.time >= newest - settings.delay and not (state.ended or full):
        return False
    copy(out, row)
    state.first += 1
    instant, source = row.time + settings.delay, state.last - 1  # the last sample up to the instant
    oldest = max(state.last - kept, 0)
    while source >= oldest and state.samples[source % kept].time > instant:
        source -= 1
    motion = state.samples[source % kept]
    known = source >= oldest and instant - motion.time <= WITHIN
    out.speed = motion.speed if known else nan
    out.label = motion.label if known else UNKNOWN
    return True


def _mask(settings: Record, state: Record, row: Record, out: Record) -> bool:
    copy(out, row)
    depth = 0.0  # m below the contact plane; NaN: unknown
    for axis in range(3):
        depth += settings.normal[axis] * (row.pose[axis] - settings.contact[axis])
    if depth < -MARGIN and row.label == SLIP:
        out.label = UNKNOWN
    return True


def _length(x: float, y: float, z: float) -> float:
    return sqrt(x * x + y * y + z * z)
