"""polars join_asof and numpy over the whole recording: what one would write in a notebook."""

from collections.abc import Iterable

import polars as pl

from tests.benchmarks.peers.chunks import Energy, label, zeroed
from tests.benchmarks.peers.job import LENGTH, WITHIN, Job, Judged, Meter, Run, carry_out

AXES = [f"v{axis}" for axis in range(6)]


def prepare(job: Job, _: int) -> Run:
    """One fingertip after the other."""

    def run(meter: Meter) -> Iterable[Judged]:
        out: list[Judged] = []
        with meter:
            columns = dict(zip(AXES, job.velocity.T, strict=True))
            motion = pl.DataFrame({"time": job.motion_time, **columns}).set_sorted("time")
            for finger, (time, counts) in enumerate(zip(job.time, job.counts, strict=True)):
                touch = pl.DataFrame({"time": time}).set_sorted("time")
                joined = touch.join_asof(motion, on="time", strategy="backward", tolerance=WITHIN)
                known = label(joined.select(AXES).to_numpy())
                out.append((finger, known[LENGTH - 1 :], Energy().score(zeroed(counts))))
        return out

    return run


if __name__ == "__main__":
    carry_out(prepare)
