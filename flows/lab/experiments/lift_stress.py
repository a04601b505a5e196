"""Where the lift breaks: its success under other friction, mass, delay and rate, and with a dead cell."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from connectors.sim.objects import OBJECTS
from flows.lab.experiments.experiment import SEED, TRIALS, Found, Method, Progress, under
from flows.lab.experiments.hand_model import PATHS
from flows.lab.experiments.trial_setting import Conditions

FRICTIONS: Final = (0.5, 0.75, 1.25, 1.5)  # of nominal
DELAYS: Final = (25, 50, 100, 150, 200)  # ms, added
RATES: Final = (50.0, 200.0)  # Hz; the detectors have learnt at 100
DEAD: Final = 1  # the middle cell of the lower row
NOMINAL: Final = "nominal"


@dataclass(frozen=True, slots=True)
class Stressed:
    """An experiment under each condition."""

    method: str
    found: Mapping[str, Found]  # by what the condition is called

    def json(self) -> dict[str, Any]:
        """For a program."""
        return {
            "experiment": "lift",
            "method": self.method,
            "mean_success": self.found[NOMINAL].mean(self.method),
            "conditions": {
                name: {
                    "mean_success": each.mean(self.method),
                    "objects": {thing: each.success(self.method, thing) for thing in each.objects},
                }
                for name, each in self.found.items()
            },
        }


def grid(nominal: Conditions) -> dict[str, Conditions]:
    """What is tried, by name; each differs from nominal in one thing."""
    hand = nominal.hand

    def natural(**changed: Any) -> Conditions:  # noqa: ANN401 - fields of several types
        return replace(nominal, nature=replace(nominal.nature, **changed))

    def handed(**changed: Any) -> Conditions:  # noqa: ANN401 - the same
        return replace(nominal, hand=replace(hand, **changed))

    return {
        NOMINAL: nominal,
        **{f"friction x{factor:g}": natural(friction=factor) for factor in FRICTIONS},
        "mass x2": natural(mass=2.0),
        f"cell {DEAD} dead": natural(dead=(DEAD,)),
        "over MQTT": handed(path=PATHS["mqtt"]),
        **{f"delay +{delay} ms": handed(delay=hand.delay + delay / 1000) for delay in DELAYS},
        **{f"{rate:g} Hz": replace(nominal, rate=rate) for rate in RATES},
        "a hand that locks": handed(locks=True),
        "a hand twice as fast": handed(rate=2 * hand.rate),
    }


def stress(
    method: Method,
    *,
    trials: int = TRIALS,
    seed: int = SEED,
    objects: Sequence[str] = tuple(OBJECTS),
    conditions: Conditions | None = None,
    jobs: int | None = None,
    progress: Progress = lambda _done, _all, _part: None,
) -> Stressed:
    """Lift under each condition, always with the same trials; see `experiment`.

    Raises:
        InputError: if there is no such detector or rule.
        ParameterError: on less than one trial or job, or no such object.
        SlipflowError: if a process ended early.
    """
    found = under(
        "lift",
        [method],
        grid(conditions or Conditions()),
        trials=trials,
        seed=seed,
        objects=objects,
        jobs=jobs,
        progress=progress,
    )
    return Stressed(method.name, found)
