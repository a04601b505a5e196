"""What a sample costs each detector: batch 1, one core, CPU time.

CPU time and not the clock's, so that what else runs on the machine does not count; where a library uses more
threads than one, all of them do. The detectors take turns, round after round, and the median round counts, so
that a slow moment of the machine is nobody's.
"""

from collections.abc import Callable, Mapping
from itertools import cycle, islice
from statistics import median
from time import process_time_ns
from typing import Final

from operators.batch import Counts
from operators.detectors.detector import Detector, Streaming

_LEAST: Final = 1_000  # ns, shorter is no measurement
_WINDOWS: Final = 100  # different ones that a detector is given
Step = Callable[[int], object]


def costs(
    detectors: Mapping[str, Detector],
    counts: Counts,
    *,
    fingers: int = 1,
    rounds: int = 15,
    span: float = 0.02,
) -> dict[str, float]:
    """CPU time of one sample of `fingers` fingertips, us.

    A streaming detector is given sample after sample, any other a window for each, as they come live.

    Args:
        detectors: by name.
        counts: (n, 6) zeroed counts of a recording, longer than the longest window; they are gone through
            again and again.
        fingers: Fingertips that are sampled together; they feel the same.
        rounds: Turns that each detector takes.
        span: CPU s of one turn, about.
    """
    steps = {name: _step(detector, counts, fingers) for name, detector in detectors.items()}
    turns = {name: _turn(step, span) for name, step in steps.items()}
    found: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(rounds):
        for name, step in steps.items():
            found[name].append(_timed(step, turns[name]) / turns[name] / 1000)
    return {name: median(times) for name, times in found.items()}


def _step(detector: Detector, counts: Counts, fingers: int) -> Step:
    """What makes a detector take its next samples, a number of them."""
    take: Callable[[Counts], object]
    if isinstance(detector, Streaming):
        take = detector.stream(fingers).push
        given = [row[None, None].repeat(fingers, axis=1) for row in counts]  # (1, fingers, 6)
    else:
        take, length = detector.score, detector.length
        begins = range(0, len(counts) - length + 1, max(1, (len(counts) - length) // _WINDOWS))
        given = [counts[None, at : at + length].repeat(fingers, axis=0) for at in begins]
    samples = cycle(given)

    def step(number: int) -> None:
        for sample in islice(samples, number):
            take(sample)

    return step


def _turn(step: Step, span: float) -> int:
    """How many samples fill a turn; the first ones warm the detector up."""
    number = 1
    step(number)
    while (taken := _timed(step, number)) < span * 1e9 / 4:
        number *= 2
    return max(1, round(number * span * 1e9 / taken))


def _timed(step: Step, number: int) -> int:
    """CPU time that a number of samples takes, ns."""
    begin = process_time_ns()
    step(number)
    return max(process_time_ns() - begin, _LEAST)
