"""The command `slipflow benchmark`."""

import sys
from pathlib import Path
from shlex import quote
from time import perf_counter
from typing import Annotated

import typer

from flows.cli.options import AsJson, Jobs, Methods, Models, Seed
from flows.cli.report_output import ReportFolder, method_options, prepare_report, write_report
from flows.cli.terminal import note, progress_bar

_STEPS = 400
_QUICK_STEPS = 100


def benchmark(
    recipes: Annotated[list[str], typer.Argument(metavar="DATASET...", help="Folders of datasets.")],
    *,
    regime: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Only this regime: zero-shot, few-shot, in-domain; repeatable (default: all).",
        ),
    ] = None,
    group: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Only recordings of this surface or object (`group` of the sessions); repeatable (default:"
            " all).",
        ),
    ] = None,
    model: Models = None,
    method: Methods = None,
    steps: Annotated[
        int, typer.Option(min=1, help="Training steps of the tcn for each held-out surface or object.")
    ] = _STEPS,
    quick: Annotated[
        bool, typer.Option("--quick", help=f"Train for {_QUICK_STEPS} steps: a first impression.")
    ] = False,
    seed: Seed = 0,
    jobs: Jobs = None,
    out: ReportFolder = Path("benchmark"),
    as_json: AsJson = False,
) -> None:
    """Evaluate detectors on real recordings of unseen surfaces.

    Holds out each surface or object (`group` of the sessions) in turn, or each recording if a dataset has
    fewer than two groups. Regimes: zero-shot, detectors as they are; few-shot, trained on two labelled
    minutes of the rest; in-domain, on all of the rest.
    Samples are converted to the rate of each detector. Exits 2 if none can be evaluated on a dataset.

    Reports balanced accuracy, AUC, calibration error, events per minute, missed slips and delay with
    intervals over recordings, next to majority, logistic and gradient-boosting baselines, and names what
    inflates a score. Writes benchmark.html, .md, .json and figures. Four surfaces take about 10 minutes of
    CPU time; trained networks are kept in OUT/models. Needs the train extra.

    Examples:
      slipflow benchmark real/strokes real/grasps
      slipflow benchmark recordings --regime zero-shot --model mine.safetensors
    """
    from flows.learn.benchmark.benchmark_report import benchmark_report
    from flows.learn.benchmark.benchmark_study import benchmark as run_benchmark
    from flows.learn.benchmark.entrants import REGIMES, Course
    from flows.learn.training.recipe import REAL_TOUCH, Recipe
    from operators.errors import InputError

    datasets = {Path(text).resolve().name: Path(text) for text in recipes}
    prepare_report(out)
    steps = _QUICK_STEPS if quick else steps
    models, names, regimes = model or [], method or [], regime or list(REGIMES)
    began, shown = perf_counter(), 0.0

    with progress_bar("benchmark") as update:

        def progress(done: int, total: int, part: str) -> None:
            nonlocal shown
            update(done, total, part)
            share, seconds = done / total, perf_counter() - began
            if not sys.stderr.isatty() and share - shown >= 1 / 20:
                shown = share
                note(f"{100 * share:.0f} %, about {seconds * (1 / share - 1) / 60:.0f} min left: {part}")

        found = run_benchmark(
            datasets,
            Course(Recipe(steps=steps, seed=seed, augmentation=REAL_TOUCH), out / "models", seed),
            regimes=regimes,
            models=models,
            names=names,
            groups=group or [],
            jobs=jobs,
            log=note,
            progress=progress,
        )
    options = "".join(f" --regime {each}" for each in regime or [])
    options += "".join(f" --group {quote(each)}" for each in group or [])
    given = " ".join(recipes)
    command = f"slipflow benchmark {given}{options}{method_options(models, names)}"
    report = benchmark_report(found, f"{command} --steps {steps} --seed {seed}")
    write_report(report, out, "benchmark", as_json=as_json)
    if lacking := [each.data.name for each in found.datasets if not each.results]:
        raise InputError(", ".join(lacking), "no detector could be evaluated, for the reasons above")
