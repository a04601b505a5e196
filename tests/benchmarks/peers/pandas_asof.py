"""pandas merge_asof and numpy over the whole recording: what one would write in a notebook."""

from collections.abc import Iterable

import pandas as pd

from tests.benchmarks.peers.chunks import Energy, label, zeroed
from tests.benchmarks.peers.job import LENGTH, WITHIN, Job, Judged, Meter, Run, carry_out

AXES = [f"v{axis}" for axis in range(6)]


def prepare(job: Job, _: int) -> Run:
    """One fingertip after the other."""

    def run(meter: Meter) -> Iterable[Judged]:
        out: list[Judged] = []
        with meter:
            motion = pd.DataFrame(job.velocity, columns=AXES)
            motion.insert(0, "time", job.motion_time)
            for finger, (time, counts) in enumerate(zip(job.time, job.counts, strict=True)):
                touch = pd.DataFrame({"time": time})
                joined = pd.merge_asof(touch, motion, on="time", direction="backward", tolerance=WITHIN)
                known = label(joined[AXES].to_numpy())
                out.append((finger, known[LENGTH - 1 :], Energy().score(zeroed(counts))))
        return out

    return run


if __name__ == "__main__":
    carry_out(prepare)
