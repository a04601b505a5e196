"""csp: a graph of nodes written in Python, one chain for each fingertip, in simulated time."""

from collections.abc import Iterable
from datetime import UTC, datetime, timedelta

import csp
import numpy as np
from csp import ts

from tests.benchmarks.peers.job import Job, Judged, Meter, Run, carry_out
from tests.benchmarks.peers.records import Energy, Newest, label, zeroed

START = datetime.fromtimestamp(0, UTC).replace(tzinfo=None)


@csp.node
def zero(touch: ts[object]) -> ts[object]:
    """Counts relative to the unloaded fingertip."""
    if csp.ticked(touch):
        time, counts = touch
        return time, zeroed(counts)


@csp.node
def align(touch: ts[object], motion: ts[object]) -> ts[object]:
    """The motion of each touch: what ticks in one cycle has one stamp."""
    with csp.state():
        s_newest = Newest()
    if csp.ticked(motion):
        s_newest.take(*motion)
    if csp.ticked(touch):
        time, counts = touch
        return counts, s_newest.at(time)


@csp.node
def labelled(aligned: ts[object]) -> ts[object]:
    """What the motion says."""
    if csp.ticked(aligned):
        counts, velocity = aligned
        return counts, label(velocity)


@csp.node
def score(touch: ts[object]) -> ts[object]:
    """What the window says."""
    with csp.state():
        s_energy = Energy()
    if csp.ticked(touch):
        counts, known = touch
        value = s_energy.score(counts)
        if value is not None:
            return known, value


@csp.node
def keep(judged: ts[object], finger: int, out: object):
    """The sink."""
    if csp.ticked(judged):
        known, value = judged
        out.append((finger, known, value))


@csp.graph
def graph(touches: object, motions: object, out: object):
    """The job."""
    motion = csp.curve(object, motions)
    for finger, touch in enumerate(touches):
        keep(score(labelled(align(zero(csp.curve(object, touch)), motion))), finger, out)


def curve(times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What csp takes: stamps, and (stamp, row) as Python objects."""
    rows = np.empty(len(times), object)
    rows[:] = [(time, tuple(row)) for time, row in zip(times.tolist(), values.tolist(), strict=True)]
    return times.view("datetime64[ns]"), rows


def prepare(job: Job, _: int) -> Run:
    """Each record by itself."""
    touches = [curve(*touch) for touch in zip(job.time, job.counts, strict=True)]
    motions = curve(job.motion_time, job.velocity)

    def run(meter: Meter) -> Iterable[Judged]:
        out: list[Judged] = []
        with meter:
            csp.run(graph, touches, motions, out, starttime=START, endtime=timedelta(days=365))
        return out

    return run


if __name__ == "__main__":
    carry_out(prepare)
