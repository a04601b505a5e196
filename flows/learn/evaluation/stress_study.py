"""`slipflow evaluate --stress`: every detector along every stress field of the simulation.

All conditions are simulated with the same seed, so that recordings differ only by the stress. Detectors are
compared with the label by arm speed, and with the true sliding of the contact: a wrong clock changes the
label alone.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, TypeAlias, cast

import polars as pl

from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import PaperStrokes, Scene
from flows.learn.evaluation.evaluation_study import Evaluation, Progress, judge_all, method_results
from flows.learn.evaluation.folds import Fold
from flows.learn.evaluation.methods import Candidate, FittedMethod, baselines, trained_methods
from flows.learn.labelled_recordings import simulated_recordings
from flows.report.results import joined
from flows.run.executor import map_tasks, one_thread
from operators import Score
from operators.fingertip import TAKKTILE

Change: TypeAlias = Callable[[Scene, float], Scene]
NOMINAL: Final = "nominal"  # condition
PLAN: Final = PaperPlan(repeats=1, rotations=1)  # 16 recordings, 5 minutes
TRAINING: Final = PaperPlan(repeats=3, rotations=1)  # 40 recordings, 14 minutes
SEED: Final = 4000
_FITTING: Final = 1000  # added to the seed for the recordings that baselines are fitted to
_TUNING: Final = 2000  # added to the seed for the recordings that the debounce is tuned on


def stress(
    *,
    names: Collection[str] = (),
    seed: int = SEED,
    plan: PaperPlan = PLAN,
    training: PaperPlan = TRAINING,
    executor: Executor | None = None,
    progress: Progress = lambda _done, _all: None,
) -> Evaluation:
    """Judge methods under every stress; the conditions of the results are those of `condition_name`.

    Args:
        names: Files of weights to judge, too, and names: only these methods; empty: all.
        seed: Seed of the recordings.
        plan: Recordings of each condition.
        training: Plan of the nominal recordings, of other seeds, for fitting the baselines and tuning the
            debounce of methods without a card.
        executor: Executor of `workers`; None: this process.
        progress: Called with the number of conditions done, and of all.

    Raises:
        InputError: if a method or model does not exist.
        FingertipError: if a model was made for another fingertip than the simulated one.
        SlipflowError: if a worker died.
    """
    trained = trained_methods(names)
    for each in trained:
        Score(each.detector).for_fingertip(TAKKTILE)
    candidates: list[Candidate] = [*trained, *baselines(names)]
    train, validation = (simulated_recordings(training, seed + more) for more in (_FITTING, _TUNING))
    tasks = [(each, Fold("", train, validation, ())) for each in candidates]
    fitted = judge_all("", tasks, executor=executor)
    conditions = {condition_name(field, value): (field, value) for field, value in every_condition()}
    work = partial(_results, list(fitted.methods.values()), plan, seed)
    results = joined(map_tasks(work, list(conditions.items()), executor, progress=progress))
    return replace(fitted, subject=f"simulated with seed {seed}", results=results)


def every_condition() -> list[tuple[str, float]]:
    """Return each value of each field."""
    return [(field, value) for field, values in FIELDS.items() for value in values.values]


def condition_name(field: str, value: float) -> str:
    """Return the name of a condition.

    The nominal value of every field gives the same recordings, except for slip speed, whose plan differs.

    >>> condition_name("noise", 14), condition_name("noise", 0.6), condition_name("slip_speed", 1)
    ('noise 14', 'nominal', 'slip_speed 1')
    """
    nominal = value == FIELDS[field].nominal and field != "slip_speed"
    return NOMINAL if nominal else f"{field} {value:g}"


@one_thread()
def _results(
    methods: Sequence[FittedMethod], plan: PaperPlan, seed: int, condition: tuple[str, tuple[str, float]]
) -> pl.DataFrame:
    name, (field, value) = condition
    recordings = simulated_recordings(plan_of(field, plan), seed, lambda scene: stressed(scene, field, value))
    return joined(method_results(method, recordings, condition=name) for method in methods)


@dataclass(frozen=True, slots=True)
class StressField:
    """One quantity that makes a scene harder: its effect, values and display.

    >>> FIELDS["slip_speed"].show(0.2), FIELDS["noise"].show(14.0)
    ('10 mm/s', '14 counts')
    """

    change: Change
    values: tuple[float, ...]  # nominal first, then increasing stress; a second side follows the first
    text: str  # title of the panel
    unit: str = ""  # of the displayed value
    scale: float = 1.0  # factor from value to displayed value

    def number(self, value: float) -> str:
        """Return a value as text, without its unit."""
        return f"{value * self.scale:.3g}"

    def show(self, value: float) -> str:
        """Return a value as text with its unit."""
        return f"{self.number(value)} {self.unit}".rstrip()

    @property
    def nominal(self) -> float:
        """Value without effect."""
        return self.values[0]


def stressed(scene: Scene, field: str, value: float) -> Scene:
    """Return a scene under one of the stresses `FIELDS`."""
    return scene if value == FIELDS[field].nominal else FIELDS[field].change(scene, value)


def _changed(scene: Scene, part: str, **values: Any) -> Scene:
    changes: dict[str, Any] = {part: replace(getattr(scene, part), **values)}
    return replace(scene, **changes)


def _value(part: str, name: str) -> Change:
    return lambda scene, value: _changed(scene, part, **{name: value})


def _friction(scene: Scene, value: float) -> Scene:
    p = scene.parameters
    static, kinetic = value * p.static_friction, value * p.kinetic_friction
    return _changed(scene, "parameters", static_friction=static, kinetic_friction=kinetic)


def _stick_slip(scene: Scene, value: float) -> Scene:
    p = scene.parameters
    static = value * p.static_friction + (1 - value) * p.kinetic_friction
    return _changed(scene, "parameters", static_friction=static)


def _vibration(scene: Scene, value: float) -> Scene:
    return _changed(scene, "vibration", amplitude=scene.vibration.amplitude + value)


def _force(scene: Scene, value: float) -> Scene:
    return _changed(scene, "plan", force=value * cast("PaperStrokes", scene.plan).force)


def _speed(scene: Scene, value: float) -> Scene:
    speed = cast("PaperStrokes", scene.plan).speed  # of strokes; rotations have none
    return _changed(scene, "plan", speed=speed and value * speed)


FIELDS: Final[Mapping[str, StressField]] = {
    "noise": StressField(_value("parameters", "noise"), (0.6, 3.5, 7, 14, 28), "noise", "counts"),
    "gain": StressField(_value("faults", "gain"), (1, 1.5, 2.5, 0.5, 0.25, 0.1), "gain"),
    "offset": StressField(_value("faults", "offset"), (0, 200, 400, -200, -400), "offset", "counts"),
    "drift": StressField(_value("faults", "drift"), (0, 2, 6, 20, -2, -6, -20), "drift", "counts/s"),
    "dead": StressField(_value("faults", "dead"), (0, 1, 2, 3, 4), "dead cells"),
    "lost": StressField(_value("touch", "dropped"), (0, 0.05, 0.1, 0.2, 0.4), "touch lost", "%", 100),
    "clock": StressField(
        _value("touch", "offset"), (0, 0.05, 0.1, -0.05, -0.1), "touch clock off", "ms", 1e3
    ),
    "vibration": StressField(_vibration, (0, 1.5e-4, 3e-4, 4.5e-4, 9e-4), "more vibration", "mm", 1e3),
    "friction": StressField(_friction, (1, 0.7, 0.5, 0.3, 0.15), "friction", "x"),
    "stick_slip": StressField(_stick_slip, (1, 0.75, 0.5, 0.25, 0), "stick-slip", "x"),
    "force": StressField(_force, (1, 2, 4, 0.5, 0.25, 0.1), "grip force", "x"),
    "slip_speed": StressField(_speed, (1, 0.6, 0.4, 0.2, 0.08), "slip speed", "mm/s", 50),
}


def plan_of(field: str, plan: PaperPlan) -> PaperPlan:
    """Return the plan that a field is applied to; for slip speed, all strokes at 50 mm/s and no rotation.

    So each factor of slip speed corresponds to one speed of all strokes.
    """
    if field != "slip_speed":
        return plan
    return replace(plan, speeds=(0.05,) * len(plan.speeds), rotations=0)
