"""True sliding of a simulated contact as motion, to label samples by."""

from dataclasses import dataclass
from math import nan

import numpy as np

from operators.batch import Motion, Truth, ms
from operators.checks import check_above
from operators.operator import Operator
from operators.steps import Record, RowType, Steps

_ROWS = 512  # rows whose travel is kept: half a second at 1 kHz
_GAP = 50 * ms  # ns, longest time between two rows; nothing slides in a longer one


@dataclass
class SlidingMotion(Operator[Truth, Motion]):
    """Convert the truth of a simulation to motion, so that `Align` and `Label` label samples by true sliding.

    The velocity's first component is the mean sliding speed of the contact over the last `span`, the others
    are 0, and the pose is unknown. So stick-slip is one slip, and all evidence for a label lies in the past.
    Between slip and rest the speed is NaN, so that the label is unknown: the mean over `span` does not exceed
    `speed`, but the mean over `rest` exceeds a third of it.

    Args:
        speed: Mean speed from which the contact slips, m/s; as in `Label`.
        span: Time over which the speed is the mean, ns.
        rest: Time over which a contact at rest has hardly slid, ns.

    Raises:
        ParameterError: if a parameter is not above 0, or `rest` is shorter than `span`.

    >>> truth = Truth(np.arange(4) * 10 * ms, np.array([0, 0.05, 0, 0.1]), np.ones(4), np.zeros((4, 3)))
    >>> SlidingMotion(span=20 * ms).push(truth).velocity[:, 0]
    array([0.   , 0.025, 0.025, 0.05 ])
    """

    speed: float = 0.003  # as in the paper's labels
    span: int = 150 * ms  # stick-slip has pauses of 50 to 100 ms
    rest: int = 250 * ms

    def __post_init__(self) -> None:
        check_above("SlidingMotion", "speed", self.speed, 0, "m/s")
        check_above("SlidingMotion", "span", self.span, 0, "ns")
        check_above("SlidingMotion", "rest", self.rest, self.span - 1, "ns")

    def steps(self, *given: RowType) -> Steps:
        """Return the step from truth to motion."""
        settings = {"speed": float(self.speed), "span": self.span, "rest": self.rest}
        state = {
            "times": np.zeros(_ROWS, np.int64),  # ns
            "travels": np.zeros(_ROWS),  # m, that the contact has slid until then
            "rows": 0,
        }
        return Steps(settings, state, step=_step)


def _step(settings: Record, state: Record, row: Record, out: Record) -> bool:
    newest = (state.rows - 1) % _ROWS
    travel = 0.0
    if state.rows:
        elapsed = row.time - state.times[newest]
        travel = state.travels[newest] + (row.sliding * elapsed / 1e9 if elapsed <= _GAP else 0.0)
    state.times[state.rows % _ROWS], state.travels[state.rows % _ROWS] = row.time, travel
    state.rows += 1
    speed = (travel - _before(state, row.time - settings.span)) / (settings.span / 1e9)
    slow = (travel - _before(state, row.time - settings.rest)) / (settings.rest / 1e9)
    out.time = out.device_time = row.time
    for axis in range(6):
        out.velocity[axis], out.pose[axis] = 0.0, nan
    out.velocity[0] = nan if speed <= settings.speed and slow > settings.speed / 3 else speed
    return True


def _before(state: Record, instant: int) -> float:
    """Return the travel (m) at the last row up to an instant, or at the oldest one that is kept."""
    number, oldest = state.rows - 1, max(state.rows - _ROWS, 0)
    while number > oldest and state.times[number % _ROWS] > instant:
        number -= 1
    return float(state.travels[number % _ROWS])
