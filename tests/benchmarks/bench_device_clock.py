"""How far off `DeviceClock` puts rows: by how they are late, its window, and how the clock drifts.

Run by `make bench`. Ten minutes of a clock that drifts by 50 ppm, or by 45 to 55, up and down once, as a room
warms and cools. Rows come in order. *Independent*: each is late by itself, so that at 500 Hz one comes in
time only if a dozen before it do. *Woken*: a reader is kept away again and again, and then takes what is
there. Both up to 20 ms, or exponentially with a mean of 20 ms. Errors are those beyond the shortest way, with
the beginning; the worst of some seeds and both signs of the drift. Known drift: the least lateness of the
last 120 s, which is left to who is told the clock's drift.
"""

import argparse
from collections.abc import Callable

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from operators import DeviceClock, Motion, ms, s
from operators.batch import Reals, Times
from tests.benchmarks.machine import commit, machine

SECONDS = 600
WINDOWS = (30, 120, 480)  # s
KNOWN = 120  # s
DRIFT, WANDER = 50e-6, 5e-6  # s/s
Way = Callable[[np.random.Generator, Reals], Reals]
Lateness = Callable[[np.random.Generator, int], Reals]


def uniform(random: np.random.Generator, size: int) -> Reals:
    """Up to 20 ms."""
    return random.uniform(0, 0.02, size)


def exponential(random: np.random.Generator, size: int) -> Reals:
    """20 ms in the mean."""
    return random.exponential(0.02, size)


def independent(lateness: Lateness) -> Way:
    """Each row late by itself, none overtaking another."""
    return lambda random, sent: np.maximum.accumulate(sent + lateness(random, len(sent)))


def woken(lateness: Lateness) -> Way:
    """A reader that comes again and again."""

    def way(random: np.random.Generator, sent: Reals) -> Reals:
        wakes: Reals = np.cumsum(lateness(random, 200 * SECONDS))
        return wakes[np.searchsorted(wakes, sent)]

    return way


WAYS: dict[str, Way] = {
    "independent, up to 20 ms": independent(uniform),
    "independent, exponential": independent(exponential),
    "woken, up to 20 ms": woken(uniform),
    "woken, exponential": woken(exponential),
}


def stream(sent: Reals, arrived: Reals, drift: float, wander: float) -> Motion:
    """What comes of rows sent and arrived at some times (s), over a way of 5 ms at least."""
    turn = SECONDS / (2 * np.pi)  # s
    device = sent * (1 + drift) + wander * turn * (1 - np.cos(sent / turn))
    nothing = np.zeros((len(sent), 6))
    return Motion(stamps(arrived) + 5 * ms, stamps(device), nothing, nothing)


def stamps(seconds: Reals) -> Times:
    """As ns."""
    return np.rint(seconds * s).astype(np.int64)


def p99(errors: Times | Reals) -> float:
    """Of their size, ms."""
    return float(np.percentile(np.abs(errors), 99)) / ms


def off(sent: Reals, arrived: Reals, window: int, drift: float, wander: float) -> float:
    """By how much rows are put wrong over a window (s): p99, ms."""
    placed = DeviceClock(window=window * s).push(stream(sent, arrived, drift, wander))
    return p99(placed.time - stamps(sent) - 5 * ms)


def known(sent: Reals, arrived: Reals) -> float:
    """The lateness of the least late row so far, and not longer ago than a window: p99, ms."""
    least = stamps(arrived - sent).reshape(SECONDS, -1)  # (seconds, rate)
    within = np.minimum.accumulate(least, axis=1)  # each second
    before = np.concatenate((np.full(KNOWN, np.iinfo(np.int64).max), least.min(axis=1)[:-1]))
    windows = sliding_window_view(before, KNOWN).min(axis=1)  # (seconds,) of the seconds before each
    return p99(np.minimum(within, windows[:, None]))


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="of which the worst is told")
    options = parser.parse_args()
    print(f"seeds 0 to {options.seeds - 1}, commit {commit()}")
    print(f"{machine()}, numpy {np.__version__}")
    print(f"{'p99 of the error, ms':32}{'50 ppm':>24}{'45 to 55 ppm':>24}{'known':>8}")
    windows = "".join(f"{f'{window} s':>8}" for window in WINDOWS)
    print(f"{'rows late':24}{'Hz':>8}{windows}{windows}{'drift':>8}")
    for name, way in WAYS.items():
        for rate in (125.0, 500.0):
            sent = np.arange(SECONDS * round(rate)) / rate  # (n,) s
            arrivals = [way(np.random.default_rng(seed), sent) for seed in range(options.seeds)]
            errors = [
                max(
                    off(sent, arrived, window, sign * DRIFT, sign * wander)
                    for arrived in arrivals
                    for sign in (1, -1)
                )
                for wander in (0.0, WANDER)
                for window in WINDOWS
            ]
            errors.append(max(known(sent, arrived) for arrived in arrivals))
            print(f"{name:24}{rate:8.0f}{''.join(f'{error:8.2f}' for error in errors)}", flush=True)


if __name__ == "__main__":
    main()
