"""csp: the same graph of the nodes that csp has in C++, on scalar streams."""

from collections.abc import Iterable
from datetime import UTC, datetime, timedelta

import csp
import csp.stats
import numpy as np

from tests.benchmarks.peers.job import (
    BASELINE,
    HALF,
    LENGTH,
    LIMIT,
    SLIP,
    WITHIN,
    Job,
    Judged,
    Meter,
    Run,
    carry_out,
)

START = datetime.fromtimestamp(0, UTC).replace(tzinfo=None)
CELLS = "abcdef"
LAST = "uvwxyz"  # of the same cells, zeroed, in the sample before
ZEROED = "".join(f"var {c}0 := {c} - {BASELINE}; " for c in CELLS)
STEP = (
    f"{ZEROED}var step := seen * ("
    + " + ".join(f"({c}0 - {last})*({c}0 - {last})" for c, last in zip(CELLS, LAST, strict=True))
    + "); seen := 1; "
    + " ".join(f"{last} := {c}0;" for c, last in zip(CELLS, LAST, strict=True))
    + " step"
)
KNOWN = f"time - moved <= {WITHIN} and speed < {LIMIT}"
LABEL = f"var speed := hypot(mx, my); ({KNOWN}) ? (speed > {SLIP} ? 1 : 0) : -1"
SCORE = f"var energy := total / {LENGTH}; energy / (energy + {HALF})"


@csp.graph
def graph(touches: object, motions: object):
    """The job."""
    far = [csp.const(-2.0 * WITHIN), csp.const(0.0), csp.const(0.0)]  # before the first motion
    moved = {
        name: csp.merge(csp.curve(float, curve), before)
        for name, curve, before in zip(("moved", "mx", "my"), motions, far, strict=True)
    }
    for finger, (time, *cells) in enumerate(touches):
        stamp = csp.curve(float, time)
        counts = {name: csp.curve(float, cell) for name, cell in zip(CELLS, cells, strict=True)}
        state = dict.fromkeys((*LAST, "seen"), 0.0)
        step = csp.exprtk(STEP, counts, state_vars=state, trigger=stamp)
        label = csp.exprtk(LABEL, {**moved, "time": stamp}, trigger=stamp)
        total = csp.stats.sum(step, interval=LENGTH, min_window=LENGTH)
        csp.add_graph_output(("score", finger), csp.exprtk(SCORE, {"total": total}))
        csp.add_graph_output(("label", finger), label)


def values(ticks):
    """Of ticks with their stamps, (n,)."""
    return np.array([value for _, value in ticks])


def prepare(job: Job, _: int) -> Run:
    """Scalar streams: the stamp itself and each cell or component are curves of one stamp."""

    def curves(times: np.ndarray, columns: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        stamps = times.view("datetime64[ns]")
        values = (times, *columns)
        return [(stamps, np.ascontiguousarray(each, np.float64)) for each in values]

    touches = [curves(time, counts.T) for time, counts in zip(job.time, job.counts, strict=True)]
    motions = curves(job.motion_time, job.velocity.T[:2])

    def run(meter: Meter) -> Iterable[Judged]:
        with meter:
            out = csp.run(graph, touches, motions, starttime=START, endtime=timedelta(days=365))
        return [
            (finger, values(out["label", finger])[LENGTH - 1 :], values(out["score", finger]))
            for finger in range(len(touches))
        ]

    return run


if __name__ == "__main__":
    carry_out(prepare)
