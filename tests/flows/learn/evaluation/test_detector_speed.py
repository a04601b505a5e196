from dataclasses import dataclass

import numpy as np
import pytest

from flows.learn.evaluation import detector_speed as speed
from flows.learn.labelled_recordings import LabelledRecording
from operators.batch import Counts, Reals

COUNTS = np.arange(300 * 6, dtype=np.int16).reshape(300, 6)


def test_a_cost_is_the_cpu_time_of_the_median_round(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0]  # ns
    monkeypatch.setattr(speed, "process_time_ns", lambda: clock[0])

    @dataclass
    class Slow:
        nanoseconds: int  # of each sample
        length: int = 20
        calls: int = 0
        name = "slow"

        def score(self, windows: Counts | Reals) -> Reals:
            hiccup = 10**9 if self.calls == 200 else 0
            self.calls += 1
            clock[0] += self.nanoseconds + hiccup
            return np.zeros(len(windows))

    recording = LabelledRecording(COUNTS, np.zeros(300, np.int8))
    detectors = {"slow": Slow(50_000), "fast": Slow(2_000)}
    found = speed.sample_times(detectors, [recording], rounds=3, span=1e-3)
    assert found == {"slow": 50.0, "fast": 2.0}
