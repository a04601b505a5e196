from dataclasses import dataclass, field

import numpy as np
import pytest

from flows.learn.evaluation import detector_speed as speed
from flows.learn.evaluation.detector_speed import costs
from operators.batch import Counts, Reals

COUNTS = np.arange(300 * 6, dtype=np.int16).reshape(300, 6)


@dataclass
class Windowed:
    length: int = 20
    seen: list[Counts | Reals] = field(default_factory=list[Counts | Reals])
    name = "windowed"

    def score(self, windows: Counts | Reals) -> Reals:
        self.seen.append(windows)
        return np.zeros(len(windows))


@dataclass
class Streamed(Windowed):
    pushed: list[Counts | Reals] = field(default_factory=list[Counts | Reals])

    def stream(self, fingers: int = 1) -> "Streamed":
        assert fingers == 1
        return self

    def push(self, counts: Counts | Reals) -> Reals:
        self.pushed.append(counts)
        return np.zeros(counts.shape[:2])


def test_each_is_given_samples_as_they_come_live() -> None:
    windowed, streamed = Windowed(), Streamed()
    found = costs({"one": windowed, "other": streamed}, COUNTS, rounds=2, span=1e-4)
    assert found.keys() == {"one", "other"}
    assert all(cost > 0 for cost in found.values())
    assert {window.shape for window in windowed.seen} == {(1, 20, 6)}
    np.testing.assert_array_equal(windowed.seen[0][0], COUNTS[:20])
    assert not streamed.seen
    assert {sample.shape for sample in streamed.pushed} == {(1, 1, 6)}
    np.testing.assert_array_equal(np.concatenate(streamed.pushed)[:300, 0], COUNTS[: len(streamed.pushed)])


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
