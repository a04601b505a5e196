"""True sliding of a simulated contact as motion, to label samples by."""

from dataclasses import dataclass
from math import nan

from operators.batch import Motion, Truth, ms
from operators.checks import check_at_least
from operators.operator import Operator
from operators.steps import END, Record, RowType, Steps, copy, queue


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

    >>> import numpy as np
    >>> truth = Truth(np.arange(4) * 10 * ms, np.array([0, 0.05, 0, 0.04]), np.ones(4), np.zeros((4, 3)))
    >>> SlidingMotion().push(truth).velocity[:, 0]
    array([0.  , 0.05, 0.05, 0.04])
    """

    speed: float = 0.003  # as in the paper's labels
    stick: int = 150 * ms  # stick-slip has pauses of 50 to 100 ms

    def __post_init__(self) -> None:
        check_at_least("SlidingMotion", "speed", self.speed, 0, "m/s")
        check_at_least("SlidingMotion", "stick", self.stick, 0, "ns")

    def steps(self, *given: RowType) -> Steps:
        """Return the functions that take truth and give motion."""
        held = queue(given[0], self.stick)
        return Steps(
            settings={"speed": float(self.speed), "stick": self.stick},
            state={
                "held": held,  # rows since the last slide
                "first": 0,  # number of the oldest row that waits
                "known": 0,  # number after the last row whose speed is known
                "last": 0,  # number after the newest one
                "slid": -END // 2,  # ns, latest row of a slide
                "fastest": 0.0,  # m/s, in that row
                "stuck": 0,  # the known rows but the last one are a stick
                "level": 0.0,  # m/s, their speed then
                "ended": 0,
            },
            takes=(_take,),
            give=_give,
            held=len(held),
        )


def _take(settings: Record, state: Record, row: Record) -> None:
    copy(state.held[state.last % len(state.held)], row)
    state.last += 1
    slides, since = row.sliding > settings.speed, row.time - state.slid
    if slides or since > settings.stick:
        state.known = state.last
    state.stuck = slides and since <= settings.stick
    if slides:
        state.level, state.fastest, state.slid = state.fastest, row.sliding, row.time


def _give(settings: Record, state: Record, out: Record) -> bool:
    full = state.last - state.first == len(state.held)
    if state.first >= state.known and not (full or (state.ended and state.first < state.last)):
        return False
    row = state.held[state.first % len(state.held)]
    state.first += 1
    stuck = state.stuck and state.first < state.known
    out.time = out.device_time = row.time
    for axis in range(6):
        out.velocity[axis], out.pose[axis] = 0.0, nan
    out.velocity[0] = state.level if stuck else row.sliding
    return True
