"""The command `slipflow onnx`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.terminal import check_output_file


def onnx(
    model: Annotated[
        str, typer.Argument(metavar="MODEL", help="File of tcn weights, or tcn for the shipped model.")
    ],
    out: Annotated[Path, typer.Argument(metavar="FILE", help="ONNX file to write.")],
) -> None:
    """Export a tcn as ONNX for other runtimes.

    Input: windows of zeroed counts. Output: the calibrated probability of slip. Needs the train extra.

    Examples:
      slipflow onnx mine.safetensors mine.onnx
    """
    from flows.learn.training.onnx_export import export_onnx
    from operators.detectors import Tcn
    from operators.errors import InputError
    from operators.extras import require_extra
    from storage import load_detector

    require_extra("train", "onnx")
    detector = load_detector(model)
    if not isinstance(detector, Tcn):
        raise InputError(model, "is not a tcn; only a tcn can be exported: give tcn or a file of its weights")
    check_output_file(out)
    export_onnx(detector, out)
    typer.echo(f"wrote {out}")
