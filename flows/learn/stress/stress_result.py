"""What the stresses did to each detector."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from flows.learn.evaluation.judgement import TRUTHS, Judgement, Truth
from flows.learn.evaluation.sample_metrics import known
from flows.learn.stress.stress_fields import GOALS, GRIDS, breaking_point
from operators import Debounce

_MEASURES: Final = ("balanced", "false_alarms_per_min", "missed", "onset_ms")


@dataclass(frozen=True, slots=True)
class Condition:
    """One field at one value."""

    field: str
    value: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """All detectors under one condition."""

    degraded: float  # % of samples during which `Health` reports a fault
    unscored: Mapping[str, float]  # % of samples, by detector
    judged: Mapping[tuple[str, Truth], Judgement]  # by detector


@dataclass(frozen=True, slots=True)
class Stress:
    """What the stresses did."""

    names: tuple[str, ...]  # of the detectors
    seed: int
    recordings: int  # of each condition
    debounce: Mapping[str, Debounce]  # of each detector: its card's, or tuned on nominal recordings
    missing: Mapping[str, str]  # methods that were not judged, and why
    outcomes: Mapping[Condition, Outcome]
    seconds: float  # that it took

    def at(self, name: str, field: str, value: float, truth: Truth = "label") -> Judgement:
        """One detector under one condition."""
        return self.outcome(field, value).judged[name, truth]

    def outcome(self, field: str, value: float) -> Outcome:
        """All detectors under one condition."""
        return self.outcomes[Condition(field, value)]

    def breaking(self, name: str, field: str, truth: Truth = "label") -> dict[str, float | None]:
        """Where balanced accuracy has fallen by 10 points, on each side of nominal; None: nowhere."""
        return {
            side: breaking_point(values, [self.at(name, field, value, truth).balanced for value in values])
            for side, values in GRIDS[field].sides.items()
        }

    def json(self) -> dict[str, Any]:
        """All of it, for a program: numbers, and null for what there is not."""
        return {
            "seed": self.seed,
            "recordings": self.recordings,
            "seconds": self.seconds,
            "methods": list(self.names),
            "missing": dict(self.missing),
            "debounce": {
                name: {key: getattr(each, key) for key in ("threshold", "consecutive", "release", "minimum")}
                for name, each in self.debounce.items()
            },
            "fields": {field: self._field(field) for field in GRIDS},
            "goals": [
                {
                    "goal": goal.text,
                    "field": goal.field,
                    "value": goal.value,
                    "least": goal.least,
                    **{
                        truth: {
                            name: known(self.at(name, goal.field, goal.value, truth).balanced)
                            for name in self.names
                        }
                        for truth in TRUTHS
                    },
                }
                for goal in GOALS
            ],
        }

    def _field(self, field: str) -> dict[str, Any]:
        values = GRIDS[field].values
        outcomes = [self.outcome(field, value) for value in values]
        by_method = {
            name: {
                "unscored": [each.unscored[name] for each in outcomes],
                **{
                    truth: {
                        **{
                            key: [known(getattr(each.judged[name, truth], key)) for each in outcomes]
                            for key in _MEASURES
                        },
                        "breaking": self.breaking(name, field, truth),
                    }
                    for truth in TRUTHS
                },
            }
            for name in self.names
        }
        return {
            "values": list(values),
            "degraded": [each.degraded for each in outcomes],
            "methods": by_method,
        }
