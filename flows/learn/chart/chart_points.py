"""The points of the chart, each what a detector costs and how accurate it is; and the goals of speed."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from flows.learn.evaluation.judgement import Judgement
from flows.learn.evaluation.sample_metrics import known


@dataclass(frozen=True, slots=True)
class Point:
    """A detector, judged on a test split and timed beside the others."""

    name: str
    us: float  # of CPU time for a sample of one fingertip
    us_64: float  # of CPU time for a sample of 64 fingertips at once, all of them
    streams: bool  # sample by sample; else on windows
    judged: Judgement
    same: bool = False  # the default detector, run by another library
    pareto: bool = False  # none is both as fast and as accurate, and better in one of the two

    @property
    def core_64(self) -> float:
        """The share of one core that 64 fingertips at 100 Hz take, %."""
        return 100 * self.us_64 * 1e-6 * 100

    def json(self) -> dict[str, Any]:
        """The point for a program; null for what there is not."""
        judged = {key: known(value) for key, value in asdict(self.judged).items()}
        return {
            "name": self.name,
            "us": self.us,
            **judged,
            "us_64": self.us_64,
            "core_64": self.core_64,
            "streams": self.streams,
            "pareto": self.pareto,
        }


@dataclass(frozen=True, slots=True)
class Goal:
    """What is hoped for, and what was reached."""

    text: str
    wanted: float
    reached: float
    at_least: bool = True

    @property
    def met(self) -> bool:
        """Whether it was reached."""
        return self.reached >= self.wanted if self.at_least else self.reached <= self.wanted


def with_front(points: Sequence[Point]) -> list[Point]:
    """The same points, those on the Pareto front of speed and accuracy marked."""
    return [replace(point, pareto=not any(_dominates(other, point) for other in points)) for point in points]


def _dominates(one: Point, other: Point) -> bool:
    fast, right = (one.us, other.us), (one.judged.accuracy, other.judged.accuracy)
    at_least = fast[0] <= fast[1] and right[0] >= right[1]
    return at_least and (fast[0] < fast[1] or right[0] > right[1])
