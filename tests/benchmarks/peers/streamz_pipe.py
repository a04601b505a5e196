"""streamz: a pipeline of map and accumulate nodes, a record at a time."""

from collections.abc import Iterable

from streamz import Stream

from tests.benchmarks.peers.job import MOTION, Job, Judged, Meter, Run, carry_out
from tests.benchmarks.peers.records import Energy, Newest, label, zeroed


def zero(record):
    """Counts relative to the unloaded fingertip."""
    finger, time, counts = record
    return finger, time, zeroed(counts)


def align(newest, record):
    """The motion of each touch; None for the motion itself."""
    finger, time, values = record
    if finger == MOTION:
        newest.take(time, values)
        return newest, None
    return newest, (finger, values, newest.at(time))


def labelled(record):
    """What the motion says."""
    finger, counts, velocity = record
    return finger, counts, label(velocity)


def score(energies, record):
    """What the window says; None before the first one is complete."""
    finger, counts, known = record
    value = energies[finger].score(counts)
    return energies, None if value is None else (finger, known, value)


def given(record) -> bool:
    """Whether there is something."""
    return record is not None


def prepare(job: Job, _: int) -> Run:
    """Each record by itself."""
    records = job.records()

    def run(meter: Meter) -> Iterable[Judged]:
        out: list[Judged] = []
        touch, motion = Stream(), Stream()
        both = touch.map(zero).union(motion)  # combine_latest would drop touches before the first motion
        aligned = both.accumulate(align, start=Newest(), returns_state=True).filter(given)
        energies = [Energy() for _ in job.time]
        scored = aligned.map(labelled).accumulate(score, start=energies, returns_state=True).filter(given)
        scored.sink(out.append)
        with meter:
            for record in records:
                (motion if record[0] == MOTION else touch).emit(record)
        return out

    return run


if __name__ == "__main__":
    carry_out(prepare)
