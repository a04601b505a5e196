"""Fit of the scene's constants to real and published figures: `make scene-fit`, or `--help`.

All constants are fitted together by response surfaces (Box and Wilson, 1951). Each round simulates a plan at
the points of an orthogonal design around the present constants, all with the same seed, fits a plane to each
target, and takes a damped Gauss-Newton step. Each point informs all slopes, so chaotic noise averages out.
The constants in the code are the start. The result is printed, to be copied there as it is, with a table of
the targets and of the same figures on seeds that the fit does not use.
"""

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any, Final, cast

import numpy as np
from scipy.linalg import hadamard

from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import PaperStrokes, Parameters
from operators.batch import Reals
from operators.detectors import Detector, PaperTcn
from tests.scene.scene_targets import CROSS_CHECK, PLAN, Target, figures, read_trace, targets

STEP: Final = 0.1  # relative change of a constant in a design
SLOPE: Final = 0.02  # rad, change of a tilt
STICTION: Final = 2.2  # largest ratio of static to kinetic friction; above it, slipping objects hardly stop
RESONANCE: Final = 20.0  # Hz, least resonance of the finger; below it, a shaking hand loses held objects
SEED: Final = 1000  # of the first round; each later round takes the next one
RUNS: Final = 32  # of a design, more than there are constants
# of `PaperPlan`, its strokes or its `Parameters`; a number is an index into a tuple
CONSTANTS: Final = (
    "normal_stiffness", "shear_stiffness", "static_friction", "kinetic_friction", "stribeck_speed", "texture",
    "texture_lengths.0", "texture_lengths.1", "mass", "stiffness", "damping", "tilt_stiffness",
    "lever", "pitch_x", "pitch_y", "depth", "shear_gain", "sensitivity", "relaxation",
    "force", "vibration", "pivot", "latency", "acceleration", "tilt.0", "tilt.1",
)  # fmt: skip

# terms of the scene without which the table of `--ablate` is printed: changes of `PaperPlan` or `Parameters`
TERMS: Final[Mapping[str, Mapping[str, Any]]] = {
    "arm vibration": {"vibration": 1e-9},
    "delay of the arm's velocity": {"latency": 0.0},
    "wandering of that delay": {"wander": 0.0},
    "slow ends of strokes": {"acceleration": 10.0},
    "rests of different length": {"pause_spread": 0.0},
    "slope of the pad on the plane": {"tilt": (0.0, 0.0)},
    "axis of rotations beside the pad": {"pivot": 0.0},
    "texture": {"texture": 0.0},
    "unevenness": {"unevenness": 0.0},
    "static friction": {"static_friction": "kinetic_friction"},
    "tilting of the pad by friction": {"lever": 1e-4},
    "response to shear": {"shear_gain": 0.0},
    "relaxation": {"relaxation": 0.0},
    "noise": {"noise": 0.0},
}

Simulate = Callable[[Iterable[tuple[PaperPlan, int]]], list[Reals]]


def constants(plan: PaperPlan) -> dict[str, float]:
    """Return the fitted constants of a plan."""
    found: dict[str, float] = {}
    for name in CONSTANTS:
        field, _, index = name.partition(".")
        parts = plan, plan.strokes, plan.parameters
        value: Any = getattr(next(part for part in parts if hasattr(part, field)), field)
        found[name] = float(value[int(index)] if index else value)
    return found


def changed(plan: PaperPlan, steps: Reals) -> PaperPlan:
    """Return a plan whose constants are changed by steps (constants,): `STEP`, or `SLOPE` of a tilt."""
    found: dict[str, Any] = {}
    for (name, value), step in zip(constants(plan).items(), steps.tolist(), strict=True):
        field, _, index = name.partition(".")
        new = value + SLOPE * step if field == "tilt" else value * float(np.exp(STEP * step))
        found[field] = (*found.get(field, ()), new) if index else new
    found["texture"] = min(found["texture"], 0.9)  # friction never vanishes
    found["static_friction"] = min(found["static_friction"], STICTION * found["kinetic_friction"])
    found["mass"] = min(found["mass"], found["stiffness"] / (2 * np.pi * RESONANCE) ** 2)
    return _with(plan, found)


def _with(plan: PaperPlan, values: Mapping[str, Any]) -> PaperPlan:
    """Return a plan with other values of fields of its parts."""

    def chosen(part: PaperPlan | PaperStrokes | Parameters) -> dict[str, Any]:
        return {name: value for name, value in values.items() if hasattr(part, name)}

    strokes = replace(plan.strokes, **chosen(plan.strokes))
    parameters = replace(plan.parameters, **chosen(plan.parameters))
    return replace(plan, strokes=strokes, parameters=parameters, **chosen(plan))


def fit(
    plan: PaperPlan, wanted: Sequence[Target], simulate: Simulate, rounds: int, log: Callable[[str], None]
) -> PaperPlan:
    """Fit the constants of a plan; the result is the mean of the last third of the rounds."""
    real, weight = np.array([each.real for each in wanted]), np.array([each.weight for each in wanted])
    at: Reals = np.zeros(len(CONSTANTS))
    path, start = list[Reals](), perf_counter()
    slopes: Reals = np.zeros((len(at), len(wanted)))
    for number in range(rounds):
        random = np.random.default_rng([SEED, number])
        signs = hadamard(RUNS)[:, 1 + random.permutation(RUNS - 1)[: len(at)]].astype(np.float64)
        signs *= random.choice([-1.0, 1.0], len(at))
        found = np.array(simulate([(changed(plan, at + row), SEED + number) for row in signs]))
        misfits = (found - real) * weight  # (runs, targets)
        mean = misfits.mean(axis=0)  # (targets,)
        slope = signs.T @ (misfits - mean) / RUNS  # (constants, targets)
        slopes = slope if number == 0 else 0.6 * slopes + 0.4 * slope
        noise = np.square(misfits - mean - signs @ slope).sum() / RUNS  # not explained by the planes
        normal: Reals = slopes @ slopes.T + noise / 2 * np.eye(len(at))
        step = cast("Reals", np.linalg.solve(normal, slopes @ mean))
        at = at - np.clip(step, -1.0, 1.0)
        path.append(at)
        log(
            f"round {number + 1} of {rounds}: sum of squared misfits {np.square(mean).sum():.1f}, "
            f"{perf_counter() - start:.0f} s; {_shown(changed(plan, at))}"
        )
    return changed(plan, np.mean(path[-max(1, rounds // 3) :], axis=0))


def without(plan: PaperPlan, term: Mapping[str, Any]) -> PaperPlan:
    """Return a plan without a term of the scene."""
    p = plan.parameters
    return _with(
        plan, {name: getattr(p, value) if isinstance(value, str) else value for name, value in term.items()}
    )


def ablation(plan: PaperPlan, wanted: Sequence[Target], simulate: Simulate) -> str:
    """Return a table of the misfit, and of the mean F1 over the surfaces, without each term of the scene."""
    plans = {"none": plan, **{name: without(plan, term) for name, term in TERMS.items()}}
    found = np.array(simulate([(each, seed) for each in plans.values() for seed in CROSS_CHECK]))
    found = found.reshape(len(plans), len(CROSS_CHECK), len(wanted)).mean(axis=1)  # (plans, targets)
    real, weight = np.array([each.real for each in wanted]), np.array([each.weight for each in wanted])
    misfit = np.square((found - real) * weight).sum(axis=1)
    surfaces = found[:, [each.text.count(",") == 2 and each.text.startswith("F1") for each in wanted]]
    rows = zip(plans, misfit.tolist(), surfaces.mean(axis=1).tolist(), strict=True)
    lines = [f"| {name} | {squares:.0f} | {f1:.1f} |" for name, squares, f1 in rows]
    return "\n".join(["| left out | sum of squared misfits | F1 % |", "| --- | ---: | ---: |", *lines])


def _shown(plan: PaperPlan) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in constants(plan).items())


_NETWORK: Final = list[Detector]()  # of a worker process


def _load(judge: Path) -> None:
    with np.load(judge) as weights:  # the paper's own network
        _NETWORK.append(PaperTcn(dict(weights)))


def _figures(task: tuple[PaperPlan, int]) -> Reals:
    return figures(*task, _NETWORK[0])


def main() -> None:
    """Fit the constants; print them and how well each target is met."""
    options = argparse.ArgumentParser(prog="python -m tests.scene.scene_fit", description=__doc__)
    options.add_argument("--judge", type=Path, required=True, help="weights of the paper's TCN")
    options.add_argument("--trace", type=Path, required=True, help="labelled real trace, CSV")
    options.add_argument("--rounds", type=int, default=8, help="rounds of the fit (default 8); 0: the table")
    options.add_argument("--ablate", action="store_true", help="print what each term of the scene gains")
    options.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    given = options.parse_args()
    wanted = targets(read_trace(given.trace))
    with get_context("spawn").Pool(given.jobs, _load, (given.judge,)) as pool:
        simulate = partial(pool.map, _figures, chunksize=1)
        plan = PLAN
        if given.rounds:
            plan = fit(PLAN, wanted, simulate, given.rounds, partial(print, file=sys.stderr, flush=True))
        found = np.mean(simulate([(plan, seed) for seed in CROSS_CHECK]), axis=0)
        if given.ablate:
            print(ablation(plan, wanted, simulate), end="\n\n")
    print("| target of the fit | weight | real | simulated |\n| --- | ---: | ---: | ---: |")
    for each, value in zip(wanted, found.tolist(), strict=True):
        print(f"| {each.text} | {each.weight:g} | {each.real:.3g} | {value:.3g} |")
    print(f"\nConstants: {_shown(plan)}")


if __name__ == "__main__":
    main()
