"""The command `slipflow train`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.derived_output import print_derived
from flows.cli.options import AsJson, KeepNew, Labels, Seed
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
    parent: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="MODEL",
            help="Continue training of this tcn (a file, or the shipped tcn_wide) on few labels: two minutes"
            " suffice.",
        ),
    ] = None,
    keep_new: KeepNew = False,
    filters: Annotated[
        int, typer.Option(min=1, help="Filters per layer of the tcn; more are slower and more accurate.")
    ] = 16,
    stretch: Annotated[
        int,
        typer.Option(
            min=1,
            max=4,
            metavar="FACTOR",
            help="Train for other fingertips on slower hands, whose strokes last FACTOR times as long: crops"
            " get random stretches and gains.",
        ),
    ] = 1,
    steps: Annotated[
        int | None,
        typer.Option(min=1, help="Number of training steps of the tcn (default: 6000; with --from 300)."),
    ] = None,
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
    labels: Labels = "hand",
    resume: Annotated[
        bool, typer.Option("--resume", help="Keep models whose card states the same data and settings.")
    ] = False,
    curve: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the learning curve to this .svg or .png file.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Train a slip detector.

    Labels given by hand in `slipflow show` replace those by arm speed; a line states how many.
    Learns from the train split; the validation split selects the best checkpoint; the test split is
    only reported. Ctrl-C stops the training without a model. Needs the train extra.

    The probability of a tcn is calibrated on validation.

    With --from, a trained tcn learns further from few labels, two minutes for example. It keeps its size, so
    that --filters, --stretch, --method and --epochs do not apply. Its
    time scale and gain are aligned with the data first. The test split, or else the last 30 % of each
    recording, is held out to compare the new model with the old one. If the new one is not better, nothing
    is written and the exit code is 3.

    Examples:
      slipflow train recordings -o mine.safetensors
      slipflow train lab simulated --filters 32 --lag 70ms --curve curve.svg
      slipflow train simulated --target sliding -o early.safetensors
      slipflow train simulated --stretch 2 -o wide.safetensors
      slipflow train --from tcn_wide two-minutes -o mine.safetensors
    """
    from flows.graph.quantity import parse_time
    from flows.learn.training.learning_curve import draw
    from flows.learn.training.recipe import Recipe
    from flows.learn.training.trainer import train as run_training
    from flows.report.figures import save
    from operators.extras import require_extra

    delay = None if lag is None else parse_time("train", "--lag", lag) / 1e9  # s
    if curve is not None:
        require_extra("report", "--curve")
        check_output_file(curve)
    if parent is not None:
        from flows.learn.adaptation.derived_model import fine_tune_model
        from flows.learn.adaptation.fine_tuning import STEPS

        if method != "tcn":
            raise typer.BadParameter(f"--method {method}: with --from only a tcn can be trained")
        with progress_bar(f"training {parent} further") as advance:
            derived = fine_tune_model(
                parent,
                datasets,
                out,
                steps=steps or STEPS,
                seed=seed,
                target=target,
                lag=delay,
                labels=labels,
                keep_new=keep_new,
                progress=advance,
                log=note,
            )
        print_derived(derived, as_json=as_json)
        return
    with progress_bar(f"training {method}") as update:

        def progress(part: str, done: int, total: int, check: "Check | None") -> None:
            update(done, total, part)
            if check:
                text = f"{part}, step {done} of {total}: accuracy {check.accuracy:.2f} % on validation"
                note(f"{text}, {check.seconds:.0f} s")

        try:
            found = run_training(
                datasets,
                out,
                method=method,
                recipe=Recipe(filters=filters, steps=steps or Recipe().steps, seed=seed).stretched_by(
                    stretch
                ),
                epochs=epochs,
                seeds=seeds,
                target=target,
                lag=delay,
                labels=labels,
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
