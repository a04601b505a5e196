"""Plain Python: each operator calls the next one with each record."""

from collections.abc import Callable, Iterable
from typing import Any

from tests.benchmarks.peers.job import MOTION, Job, Judged, Meter, Record, Run, carry_out
from tests.benchmarks.peers.records import Counts, Energy, Newest, Velocity, label, zeroed

Next = Callable[[int, int, Any, Any], None]  # fingertip, time, counts, what is known of the motion


class Zero:
    """Counts relative to the unloaded fingertip."""

    def __init__(self, following: Callable[[int, int, Counts], None]) -> None:
        self._following = following

    def push(self, finger: int, time: int, counts: Counts) -> None:
        """Hand on."""
        self._following(finger, time, zeroed(counts))


class Align:
    """The motion of each touch."""

    def __init__(self, following: Next) -> None:
        self._following, self._newest = following, Newest()

    def push_motion(self, time: int, velocity: Velocity) -> None:
        """Remember."""
        self._newest.take(time, velocity)

    def push(self, finger: int, time: int, counts: Counts) -> None:
        """Hand on."""
        self._following(finger, time, counts, self._newest.at(time))


class Label:
    """What the motion says."""

    def __init__(self, following: Next) -> None:
        self._following = following

    def push(self, finger: int, time: int, counts: Counts, velocity: Velocity | None) -> None:
        """Hand on."""
        self._following(finger, time, counts, label(velocity))


class Score:
    """What the window says."""

    def __init__(self, fingers: int, following: Callable[[Judged], None]) -> None:
        self._following, self._energies = following, [Energy() for _ in range(fingers)]

    def push(self, finger: int, time: int, counts: Counts, known: int) -> None:
        """Hand on."""
        score = self._energies[finger].score(counts)
        if score is not None:
            self._following((finger, known, score))


def prepare(job: Job, _: int) -> Run:
    """Each record by itself."""
    records: list[Record] = job.records()

    def run(meter: Meter) -> Iterable[Judged]:
        out: list[Judged] = []
        align = Align(Label(Score(len(job.time), out.append).push).push)
        zero = Zero(align.push)
        with meter:
            for finger, time, values in records:
                if finger == MOTION:
                    align.push_motion(time, values)
                else:
                    zero.push(finger, time, values)
        return out

    return run


if __name__ == "__main__":
    carry_out(prepare)
