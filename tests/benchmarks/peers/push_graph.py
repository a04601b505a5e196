"""Plain Python: each operator calls the next one with each record."""

from collections.abc import Iterable

from tests.benchmarks.peers.job import MOTION, Job, Judged, Meter, Run, carry_out
from tests.benchmarks.peers.records import Counts, Energy, Newest, Velocity, label, zeroed


def prepare(job: Job, _: int) -> Run:
    """Each record by itself."""
    records = job.records()

    def run(meter: Meter) -> Iterable[Judged]:
        out, newest, energies = list[Judged](), Newest(), [Energy() for _ in job.time]

        def zero(finger: int, time: int, counts: Counts) -> None:
            align(finger, time, zeroed(counts))

        def align(finger: int, time: int, counts: Counts) -> None:
            judge(finger, counts, newest.at(time))

        def judge(finger: int, counts: Counts, velocity: Velocity | None) -> None:
            score(finger, counts, label(velocity))

        def score(finger: int, counts: Counts, known: int) -> None:
            value = energies[finger].score(counts)
            if value is not None:
                out.append((finger, known, value))

        with meter:
            for finger, time, values in records:
                if finger == MOTION:
                    newest.take(time, values)
                else:
                    zero(finger, time, values)
        return out

    return run


if __name__ == "__main__":
    carry_out(prepare)
