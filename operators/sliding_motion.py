"""True sliding of a simulated contact as motion, to label samples by."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from operators.batch import Motion, Reals, Truth, concat, ms
from operators.checks import check_at_least
from operators.operator import Operator
from operators.row_queues import END

_AXES: Final = 6


@dataclass
class SlidingMotion(Operator[Truth, Motion]):
    """Convert the truth of a simulation to motion, so that `Align` and `Label` label samples by true sliding.

    The velocity's first component is the sliding speed of the contact, the others are 0, and the pose is
    unknown. Stick-slip is one slip: a stick between two slides that start and end within `stick` keeps the
    speed of the slide before it. So the rows after a slide are held back until the next one, at most for
    `stick`; `Align` has to wait that long.

    Args:
        speed: Sliding speed above which the contact slides, m/s; that of `Label`.
        stick: Longest time from the last row of a slide to the first of the next in the same slip, ns.

    Raises:
        ParameterError: if a parameter is below 0.

    >>> truth = Truth(np.arange(4) * 10 * ms, np.array([0, 0.05, 0, 0.04]), np.ones(4), np.zeros((4, 3)))
    >>> SlidingMotion().push(truth).velocity[:, 0]
    array([0.  , 0.05, 0.05, 0.04])
    """

    speed: float = 0.003  # as in the paper's labels
    stick: int = 150 * ms  # stick-slip has pauses of 50 to 100 ms
    _held: Truth = field(default_factory=Truth.empty, init=False, repr=False, compare=False)  # since a slide
    _slid: int = field(default=-END // 2, init=False, repr=False)  # ns, latest row of a slide
    _fastest: float = field(default=0.0, init=False, repr=False)  # m/s, in that row

    def __post_init__(self) -> None:
        check_at_least("SlidingMotion", "speed", self.speed, 0, "m/s")
        check_at_least("SlidingMotion", "stick", self.stick, 0, "ns")

    def process(self, batch: Truth) -> Motion:
        """Return the motion up to the last slide, or all of it if that is longer ago than a stick."""
        rows = concat(Truth, [self._held, batch])
        time, sliding = rows.time, rows.sliding
        slides = np.flatnonzero(sliding > self.speed)  # (k,)
        place = slides.searchsorted(np.arange(len(time)), "right")  # (n,) slides up to each row
        times = np.concatenate(([self._slid], time[slides], [END]))  # ns, before, in and after the rows
        speeds = np.concatenate(([self._fastest], sliding[slides]))  # m/s
        stuck = times[place + 1] - times[place] <= self.stick  # (n,) between two slides of a slip
        stuck[slides] = False
        speed = np.where(stuck, speeds[place], sliding)
        self._slid, self._fastest = int(times[-2]), float(speeds[-1])
        last = int(slides[-1]) + 1 if len(slides) else 0
        known = len(time) if time[-1] - self._slid > self.stick else last
        self._held = rows[known:]
        return _motion(rows[:known], speed[:known])

    def flush(self) -> Motion:
        """Return the motion since the last slide."""
        return _motion(self._held, self._held.sliding)


def _motion(rows: Truth, speed: Reals) -> Motion:
    velocity = np.zeros((len(speed), _AXES))
    velocity[:, 0] = speed
    return Motion(rows.time, rows.time, velocity, np.full_like(velocity, np.nan), finger=rows.finger)
