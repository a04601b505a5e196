"""Plain Python, live: one loop that sleeps, and calls the operators with each sample; nothing can be less."""

from time import perf_counter_ns, sleep

from tests.benchmarks.peers.live import Live, carry_out_live
from tests.benchmarks.peers.records import Energy, zeroed


def run(live: Live, _: str) -> None:
    """To the last event."""
    energies = [Energy() for _ in live.job.time]
    live.begin()
    for finger, due, counts in live.records:
        if (wait := live.wait(due)) > 0:
            sleep(wait)
        stamp = perf_counter_ns()
        score = energies[finger].score(zeroed(counts))
        if score is not None:
            live.told(finger, stamp, score)


if __name__ == "__main__":
    carry_out_live(run)
