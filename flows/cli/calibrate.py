"""The command `slipflow calibrate`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.terminal import note


def calibrate(
    model: Annotated[
        str, typer.Argument(metavar="MODEL", help="File of weights, or the name of a shipped model.")
    ],
    *,
    on: Annotated[
        list[Path],
        typer.Option(
            "--on",
            metavar="DATASET|SESSION",
            help="Labelled recordings that the model has not learned from; slips are not needed; repeatable.",
        ),
    ],
    false_alarms: Annotated[
        str,
        typer.Option(
            metavar="RATE", help="Highest rate of false alarms, per time without slip, such as 1/min or 6/h."
        ),
    ] = "1/min",
    confidence: Annotated[
        str, typer.Option(metavar="SHARE", help="Probability that the rate is kept, from 80% to 99.9%.")
    ] = "95%",
) -> None:
    """Choose a debounce that keeps a rate of false alarms.

    On data like the given recordings, false alarms are then at most as frequent as RATE, with the given
    confidence. The model card records the settings; flows use them with their parameter `false_alarms`. A
    shipped model is first copied into this folder.

    Without any false alarm, 1/min at 95% needs 3 static minutes, and 6/h needs 30. Record many sessions: each
    counts as one example of your conditions. The rate need not hold on other fingertips, motions or surfaces.

    Examples:
      slipflow calibrate mine.safetensors --on recordings --false-alarms 1/min --confidence 95%
      slipflow calibrate tcn --on lab --on simulated --false-alarms 6/h
    """
    from flows.graph.quantity import parse_quantity
    from flows.learn.alarm_calibration import calibrate_model
    from operators import minute
    from operators.checks import check_above, check_between

    rate = parse_quantity("calibrate", "--false-alarms", false_alarms, "1/ns") * minute
    share = parse_quantity("calibrate", "--confidence", confidence, "1")
    check_above("calibrate", "--false-alarms", rate, 0, "per minute")
    check_between("calibrate", "--confidence", share, 0.8, 0.999)
    path, found = calibrate_model(model, on, round(rate, 9), share, note)
    typer.echo(found.report(path))
