"""The command `slipflow train`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.options import AsJson, Seed
from flows.cli.terminal import check_output_file, note, progress_bar

if TYPE_CHECKING:
    from flows.learn.training.learning_curve import Check


def train(
    datasets: Annotated[list[Path], typer.Argument(metavar="DATASET", help="Labelled datasets with splits.")],
    *,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="Model file, .safetensors; its card has the same name with .json.",
        ),
    ] = Path("model.safetensors"),
    method: Annotated[
        str,
        typer.Option(
            help="Network: tcn, or one of the paper's: paper_tcn, frequency_cnn, frequency_cnn_interleaved."
        ),
    ] = "tcn",
    target: Annotated[
        str,
        typer.Option(
            help="Learn arm-speed, the paper's label, or sliding, the true sliding of the contact, which only"
            " simulated datasets contain."
        ),
    ] = "arm-speed",
    filters: Annotated[
        int, typer.Option(min=1, help="Filters per layer of the tcn; more are slower and more accurate.")
    ] = 16,
    steps: Annotated[int, typer.Option(min=1, help="Number of training steps of the tcn.")] = 4000,
    epochs: Annotated[int, typer.Option(min=1, help="Number of epochs of the paper's networks.")] = 20,
    seed: Seed = 0,
    seeds: Annotated[
        int,
        typer.Option(min=1, help="Train with this many seeds, from --seed on, and keep the best model."),
    ] = 1,
    lag: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="Shift each recording's labels so that they lag the signal by this time, such as 70ms"
            " (default: no shift).",
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Keep models whose card states the same data and settings.")
    ] = False,
    curve: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the learning curve to this .svg or .png file.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Train a slip detector.

    Learns from the train split; the validation split selects the best checkpoint; the test split is
    only reported. Ctrl-C stops the training without a model. Needs the train extra.

    Examples:
      slipflow train recordings -o mine.safetensors
      slipflow train lab simulated --filters 32 --lag 70ms --curve curve.svg
      slipflow train simulated --target sliding -o early.safetensors
    """
    from flows.graph.quantity import parse_time
    from flows.learn.training.learning_curve import draw
    from flows.learn.training.recipe import Recipe
    from flows.learn.training.trainer import train as run_training
    from flows.report.figures import save

    delay = None if lag is None else parse_time("train", "--lag", lag) / 1e9  # s
    if curve is not None:
        check_output_file(curve)
    with progress_bar(f"training {method}") as update:

        def progress(part: str, done: int, total: int, check: "Check | None") -> None:
            update(done, total, part)
            if check:
                note(f"{part}, {check.done}: {check.accuracy:.2f} % on validation, {check.seconds:.0f} s")

        try:
            found = run_training(
                datasets,
                out,
                method=method,
                recipe=Recipe(filters=filters, steps=steps, seed=seed),
                epochs=epochs,
                seeds=seeds,
                target=target,
                lag=delay,
                resume=resume,
                progress=progress,
                warn=note,
            )
        except KeyboardInterrupt:
            note(f"stopped: the training in progress wrote no model to {out}")
            raise
    if curve is not None:
        save(draw({f"seed {model.card['seed']}": model.curve for model in found.models}), curve)
        note(f"wrote {curve}")
    typer.echo(json.dumps(found.summary()) if as_json else found.report())
