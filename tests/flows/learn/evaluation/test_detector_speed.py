from dataclasses import dataclass, field

import numpy as np
import pytest

from flows.learn.evaluation import detector_speed as speed
from flows.learn.evaluation.detector_speed import costs
from operators.batch import Counts, Reals
from storage import load_detector

COUNTS = np.arange(300 * 6, dtype=np.int16).reshape(300, 6)


@dataclass
class Windowed:
    length: int = 20
    seen: list[Counts | Reals] = field(default_factory=list[Counts | Reals])
    name = "windowed"

    def score(self, windows: Counts | Reals) -> Reals:
        self.seen.append(windows)
        return np.zeros(len(windows))


def test_each_sample_of_the_repeated_recording_is_scored_live() -> None:
    windowed = Windowed()
    found = costs({"one": windowed, "tcn": load_detector("tcn")}, COUNTS, rounds=2, span=1e-4)
    assert found.keys() == {"one", "tcn"}
    assert all(cost > 0 for cost in found.values())
    live = np.concatenate([windows for windows in windowed.seen if len(windows) == 1])
    np.testing.assert_array_equal(live[:, -1], np.resize(COUNTS, (len(live), 6)))


def test_a_cost_is_the_cpu_time_of_the_median_round(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0]  # ns
    monkeypatch.setattr(speed, "process_time_ns", lambda: clock[0])

    @dataclass
    class Slow(Windowed):
        nanoseconds: int = 0

        def score(self, windows: Counts | Reals) -> Reals:
            hiccup = 10**9 if len(self.seen) == 200 else 0
            clock[0] += self.nanoseconds + hiccup
            return super().score(windows)

    found = costs(
        {"slow": Slow(nanoseconds=50_000), "fast": Slow(nanoseconds=2_000)}, COUNTS, rounds=3, span=1e-3
    )
    assert found == {"slow": 50.0, "fast": 2.0}
