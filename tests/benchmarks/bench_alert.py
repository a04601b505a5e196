"""Time from a sample to a subscriber that must know of the slip it shows.

Run by `make bench`. A process of its own takes a fingertip at 100 Hz, scores it, records it beside an arm at
125 Hz, and publishes an event for every sample, with state and signal; mosquitto and mosquitto_sub, which
stamps what comes, run beside it, all on loopback. The naive rig publishes signal, state and event of each
sample with paho as it comes, to a mosquitto as it comes. Each is measured as the machine lets it be, and with
real-time priority where that is allowed, so that what else the machine does counts less.
"""

import argparse
import os
from contextlib import nullcontext

import numpy as np

from tests.benchmarks.machine import commit, machine
from tests.chaos.latency import measure_latency, real_time_priority


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="of each run")
    options = parser.parse_args()
    print(f"{options.seconds:.0f} s each, commit {commit()}")
    print(f"{machine()}")
    print(f"{'ms from sample to subscriber':30}{'priority':>10}{'load':>6}{'events':>8}", end="")
    print("".join(f"{name:>8}" for name in ("p50", "p99", "p99.9", "max")))
    for name, naive, record in (
        ("ours, recording", False, True),
        ("ours", False, False),
        ("naive", True, False),
    ):
        for context in (nullcontext("normal"), real_time_priority()):
            with context as priority:
                late = measure_latency(options.seconds, naive=naive, record=record)
            values = "".join(f"{value:8.1f}" for value in np.percentile(late, (50, 99, 99.9, 100)))
            print(f"{name:30}{priority:>10}{os.getloadavg()[0]:6.1f}{len(late):8}{values}")


if __name__ == "__main__":
    main()
