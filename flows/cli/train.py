"""The command `slipflow train`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.options import Seed
from flows.cli.terminal import note, progress_bar

if TYPE_CHECKING:
    from flows.learn.training.trained_model import Check


def train(
    datasets: Annotated[
        list[Path],
        typer.Argument(
            metavar="DATASET...",
            help="Folders of labelled sessions, or single sessions, which are trained on together.",
        ),
    ],
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
        str, typer.Option(help="Network: tcn, or one of the paper's: paper_tcn, frequency_cnn.")
    ] = "tcn",
    parent: Annotated[
        str | None,
        typer.Option("--from", metavar="MODEL", help="Train this tcn further: a model file, or tcn."),
    ] = None,
    filters: Annotated[
        int, typer.Option(min=1, help="Filters per layer of the tcn; more are slower and more accurate.")
    ] = 24,
    steps: Annotated[
        int | None,
        typer.Option(min=1, help="Number of training steps of a tcn (default: 6000; with --from 300)."),
    ] = None,
    seed: Seed = 0,
) -> None:
    """Train a slip detector.

    Learns from the train split. The validation split selects the best weights, calibrates the probability and
    tunes the debounce; the test split is only reported. Labels by hand replace those by arm speed. Ctrl-C
    stops the training without a model. Needs the extra `train`.

    With --from, a tcn learns further from few labels: two minutes suffice. The test split, or else the last
    30 % of each recording, is held out to compare the new model with the old one.

    Examples:
      slipflow train recordings -o mine.safetensors
      slipflow train --from tcn two-minutes -o mine.safetensors
    """
    from flows.learn.training.recipe import PAPER_NETWORKS, PaperRecipe, Recipe
    from flows.learn.training.trainer import FURTHER_STEPS
    from flows.learn.training.trainer import train as run_training
    from flows.report.report_page import check_output_folder
    from operators.checks import check_choice

    check_choice("train", "--method", method, ("tcn", *PAPER_NETWORKS))
    if (parent or method != "tcn") and filters != 24:
        raise typer.BadParameter("--filters is for a new tcn")
    if method != "tcn" and (parent or steps):
        raise typer.BadParameter(f"--from and --steps are for a tcn, not for {method}")
    check_output_folder(out.parent)
    recipe: Recipe | PaperRecipe
    if method == "tcn":
        usual = Recipe().steps if parent is None else FURTHER_STEPS
        recipe = Recipe(filters=filters, steps=steps or usual, seed=seed)
    else:
        recipe = PaperRecipe(method, PAPER_NETWORKS[method], seed=seed)
    held_out = "the held-out part" if parent else "validation"
    with progress_bar(f"training {parent or method}") as update:

        def progress(done: int, total: int, check: "Check | None") -> None:
            update(done, total)
            if check:
                text = f"step {done} of {total}: accuracy {check.accuracy:.2f} % on {held_out}"
                note(f"{text}, {check.seconds:.0f} s")

        try:
            model = run_training(datasets, out, recipe, start=parent, progress=progress, log=note)
        except KeyboardInterrupt:
            note(f"stopped: no model was written to {out}")
            raise
    typer.echo(model.report())
