"""The commands about detectors."""

import json
from pathlib import Path
from typing import Annotated

import typer

from flows.cli.options import AsJson, Methods, Models
from flows.cli.terminal import check_output_file, note, progress_bar

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

Budget = Annotated[
    float, typer.Option(min=0, help="False alarms per static minute that thresholds are chosen for.")
]


def evaluate(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="A labelled dataset with splits.")],
    *,
    split: Annotated[str, typer.Option(help="What is judged: train, validation, test or all.")] = "test",
    model: Models = None,
    method: Methods = None,
    budget: Budget = 2.0,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the page and tables go.")] = Path(
        "evaluation"
    ),
    as_json: AsJson = False,
) -> None:
    """Judge detectors beside each other.

    Says how right they are, and what users of slip events feel. Prints the paper's Tables I and III beside
    its figures, false alarms, missed slips and onset delay, and writes evaluation.html, .md and .json.

    Examples:
      slipflow evaluate recordings --model mine.safetensors --method psd --out judged
    """
    from flows.learn.evaluation import evaluation_page as report
    from flows.learn.evaluation.evaluation_study import evaluate as judge
    from flows.report.figures import lacking
    from flows.report.report_files import make_output_folder

    make_output_folder(out)
    if reason := lacking():
        note(f"the page will be without figures, which {reason}")
    models, names = model or [], method or []
    found = judge(dataset, split=split, models=models, names=names, budget=budget, told=note)
    options = f"--split {split}{_chosen(models, names)} --budget {budget:g}"
    paths = report.write(found, out, f"slipflow evaluate {found.dataset} {options}")
    note(f"written: {paths[0]} and what it is made of")
    typer.echo(json.dumps(report.summary(found)) if as_json else report.text(found))


def train(
    datasets: Annotated[list[Path], typer.Argument(metavar="DATASET", help="Labelled datasets with splits.")],
    *,
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="FILE", help="The model, .safetensors; its card is the .json beside it."
        ),
    ] = Path("model.safetensors"),
    method: Annotated[
        str,
        typer.Option(help="tcn, or one of the paper's: paper_tcn, frequency_cnn, frequency_cnn_interleaved."),
    ] = "tcn",
    filters: Annotated[
        int, typer.Option(min=1, help="Width of the tcn: more is slower and more accurate.")
    ] = 16,
    steps: Annotated[int, typer.Option(min=1, help="Steps of the tcn's training.")] = 4000,
    epochs: Annotated[int, typer.Option(min=1, help="Epochs of the paper's networks.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Of all that is random.")] = 0,
    seeds: Annotated[
        int, typer.Option(min=1, help="Train this many, seed and those that follow; keep the best.")
    ] = 1,
    lag: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="Shift each recording's labels to come this long after the signal, as 70ms."
        ),
    ] = None,
    curve: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the course of training, .svg or .png.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Train a slip detector.

    It learns from the train split, the validation split chooses, the test split is only told. Stop it with
    Ctrl-C and start it again: the tcn goes on where it was. Needs the train extra.

    Examples:
      slipflow train recordings -o mine.safetensors
      slipflow train lab simulated --filters 32 --lag 70ms --curve curve.svg
    """
    from flows.graph.quantity import time
    from flows.learn.training.learning_curve import Check, draw
    from flows.learn.training.recipe import Recipe
    from flows.learn.training.trainer import train as learn

    after = None if lag is None else time("train", "--lag", lag)
    if curve is not None:
        check_output_file(curve)
    begun = set[str]()
    with progress_bar(f"training {method}") as update:

        def progress(part: str, done: int, of: int, check: Check | None) -> None:
            if method == "tcn" and part not in begun and done > 1:
                again = "remove the checkpoint beside the model to start anew"
                note(f"{part}: goes on after step {done - 1:,} of {of:,}, where it was stopped; {again}")
            begun.add(part)
            update(done, of, part)
            if check:
                note(f"{part}, {check.done}: {check.accuracy:.2f} % on validation, {check.seconds:.0f} s")

        try:
            found = learn(
                datasets,
                out,
                method=method,
                recipe=Recipe(filters=filters, steps=steps, seed=seed),
                epochs=epochs,
                seeds=seeds,
                lag=None if after is None else after / 1e9,
                progress=progress,
            )
        except KeyboardInterrupt:
            note("stopped; the same command goes on from the last check" if method == "tcn" else "stopped")
            raise
    if curve is not None:
        from flows.report.figures import save

        save(draw({f"seed {model.card['seed']}": model.curve for model in found.models}), curve)
        note(f"written: {curve}")
    typer.echo(json.dumps(found.summary()) if as_json else found.report())


def onnx(
    model: Annotated[
        str, typer.Argument(metavar="MODEL", help="A file of tcn weights, or tcn: the default.")
    ],
    out: Annotated[Path, typer.Argument(metavar="FILE", help="The .onnx file to write.")],
) -> None:
    """Write a tcn as ONNX, for other runtimes.

    Windows of zeroed counts go in, the probability of slip comes out. Needs the train extra.

    Examples:
      slipflow onnx mine.safetensors mine.onnx
    """
    from flows.learn.training.onnx_export import export
    from operators.detectors import Tcn
    from operators.errors import InputError
    from storage import load_detector, load_weights
    from storage.models import shipped

    if not isinstance(load_detector(model), Tcn):
        raise InputError(
            model, "is no tcn, the only detector that can be exported: give tcn, or a file of its weights"
        )
    check_output_file(out)
    export(load_weights(shipped(model) or Path(model))[0], out)
    typer.echo(f"written: {out}")


def chart(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="A labelled dataset with splits.")],
    *,
    model: Models = None,
    method: Methods = None,
    budget: Budget = 2.0,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the page and tables go.")] = Path("chart"),
    as_json: AsJson = False,
) -> None:
    """Chart speed against accuracy of every detector.

    Charts onset delay against false alarms, too. Times are of one core, sample by sample, taken by turns.
    Writes chart.html, .md, .json and .svg.

    Examples:
      slipflow chart recordings --model mine.safetensors
    """
    from flows.learn.chart import chart_page
    from flows.learn.chart.speed_accuracy import chart as measure
    from flows.report.report_files import make_output_folder

    make_output_folder(out)
    models, names = model or [], method or []
    found = measure(dataset, models, names=names, budget=budget, told=note)
    command = f"slipflow chart {found.dataset}{_chosen(models, names)} --budget {budget:g}"
    note(f"written: {', '.join(map(str, chart_page.write(found, out, command)))}")
    typer.echo(json.dumps(found.json()) if as_json else chart_page.text(found))


def stress(
    *,
    model: Models = None,
    method: Methods = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the simulated recordings.")] = 4000,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; one for each core by default.")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the page and tables go.")] = Path("stress"),
    as_json: AsJson = False,
) -> None:
    """Show where each detector fails, in minutes.

    It tries every stress of the simulated rig, from nominal to broken. Writes stress.html, .md, .json and
    figures.

    Examples:
      slipflow stress --method tcn --method psd --jobs 2
    """
    from flows.learn.stress import stress_page
    from flows.learn.stress.stress_study import stress as measure
    from flows.report.report_files import make_output_folder

    make_output_folder(out)
    models, names = model or [], method or []
    with progress_bar("stressing") as update:
        found = measure(
            models,
            names=names,
            seed=seed,
            jobs=jobs,
            told=note,
            progress=update,
        )
    command = f"slipflow stress{_chosen(models, names)} --seed {seed}"
    note(f"written: {', '.join(map(str, stress_page.write(found, out, command)))}")
    typer.echo(json.dumps(found.json()) if as_json else stress_page.text(found))


def _chosen(models: list[Path], names: list[str]) -> str:
    """Which detectors, as options of the command that a page names."""
    given = [*(f"--model {path.name}" for path in models), *(f"--method {name}" for name in names)]
    return "".join(f" {option}" for option in given)
