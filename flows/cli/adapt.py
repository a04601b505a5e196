"""The command `slipflow adapt`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.derived_output import print_derived
from flows.cli.options import AsJson, KeepNew


def adapt(
    model: Annotated[
        str, typer.Argument(metavar="MODEL", help="File of tcn weights, or a shipped one: tcn, tcn_wide.")
    ],
    *,
    to: Annotated[
        list[Path],
        typer.Option(
            "--to",
            metavar="DATASET|SESSION",
            help="Recording with rest and strokes, or a dataset of such recordings; repeatable. Labels are"
            " ignored.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="Model file, .safetensors; its card has the same name with .json.",
        ),
    ] = Path("adapted.safetensors"),
    first: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="Use only the first TIME of each recording, such as 30s (default: all)."
        ),
    ] = None,
    keep_new: KeepNew = False,
    as_json: AsJson = False,
) -> None:
    """Adapt a detector to your fingertip without labels.

    Record 30 s or more in which the finger rests for a second or longer between strokes: for example
    `slipflow run record --for 30s`, stroking a surface by hand. The activity of the counts separates rest
    from strokes. The time scale and the gain of the model are aligned with it, and its last layers learn
    from it. This takes seconds. The result is a normal model: it runs live, in replays and as ONNX.

    A third of the recording is held out to compare the new model with the old one. If the new one is not
    better, nothing is written and the exit code is 3.

    With labels, use `slipflow train --from MODEL`. Needs the train extra.

    Examples:
      slipflow adapt tcn_wide --to recordings/sessions/hand-1 -o adapted.safetensors
      slipflow adapt mine.safetensors --to lab --first 30s --json
    """
    from flows.graph.quantity import parse_time
    from flows.learn.adaptation.derived_model import adapt_model

    seconds = None if first is None else parse_time("adapt", "--first", first) / 1e9
    found = adapt_model(model, to, out, first=seconds, keep_new=keep_new)
    print_derived(found, as_json=as_json)
