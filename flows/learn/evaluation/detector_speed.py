"""CPU time of each detector per sample, batch 1.

CPU time excludes other work on the machine and includes all threads of a library. The detectors are timed in
turns, and the median turn counts, so that a temporary load of the machine has no effect.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import cycle, islice
from statistics import median
from time import process_time_ns
from typing import Final

import numpy as np

from flows.learn.labelled_recordings import LabelledRecording
from flows.run.executor import one_thread
from operators import Score
from operators.batch import Counts, Zeroed
from operators.detectors import Detector

_CHUNK: Final = 50  # samples between two looks at the clock
_TIMED: Final = 500  # samples of a recording that the timing repeats
Step = Callable[[int], object]


def sample_times(
    detectors: Mapping[str, Detector],
    recordings: Sequence[LabelledRecording],
    *,
    rounds: int = 15,
    span: float = 0.02,
) -> dict[str, float]:
    """Time detectors on a recording of one fingertip, on one thread.

    As in a live run, `Score` processes one sample at a time.

    Args:
        detectors: Detectors by name.
        recordings: The end of the longest one is repeated.
        rounds: Turns of each detector.
        span: Approximate CPU time of each turn of timing, s.

    Returns:
        CPU time of a sample by detector, us.
    """
    counts = max(recordings, key=len).counts[-_TIMED:]
    with one_thread():
        steps = {name: _step(detector, counts) for name, detector in detectors.items()}
        turns = [{name: _timed(step, span) for name, step in steps.items()} for _ in range(rounds)]
    return {name: median(turn[name] for turn in turns) for name in steps}


def _step(detector: Detector, counts: Counts) -> Step:
    """Return a function that makes a detector process a number of samples, the next ones at each call."""
    score, same_time = Score(detector), np.zeros(len(counts), np.int64)  # so that no repeated row is late
    recording = Zeroed(same_time, counts, counts, np.ones_like(counts, np.bool_))
    score.push(recording)  # fills the first window
    rows = cycle([recording.packed[at : at + 1] for at in range(len(recording))])
    return lambda number: deque((score.push(Zeroed.unpack(row)) for row in islice(rows, number)), maxlen=0)


def _timed(step: Step, span: float) -> float:
    """Return the CPU time of a sample, us: the mean of as many as take a turn."""
    begin, taken, number = process_time_ns(), 0, 0
    while taken < span * 1e9:
        step(_CHUNK)
        number += _CHUNK
        taken = process_time_ns() - begin
    return taken / number / 1000
