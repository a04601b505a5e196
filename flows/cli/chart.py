"""The command `slipflow chart`."""

from pathlib import Path

from flows.cli.options import AsJson, Methods, Models
from flows.cli.report_output import (
    Budget,
    Dataset,
    ReportFolder,
    method_options,
    prepare_report,
    write_report,
)
from flows.cli.terminal import note


def chart(
    dataset: Dataset,
    *,
    model: Models = None,
    method: Methods = None,
    budget: Budget = 2.0,
    out: ReportFolder = Path("chart"),
    as_json: AsJson = False,
) -> None:
    """Chart speed against accuracy of every detector.

    Also charts onset delay against false alarms. CPU time is measured on one core, sample by sample, in
    turns. Writes chart.html, .md, .json and .svg. Needs the train extra.

    Examples:
      slipflow chart recordings --model mine.safetensors
    """
    from flows.learn.chart.chart_report import chart_report
    from flows.learn.chart.chart_study import chart as run_chart

    prepare_report(out)
    models, names = model or [], method or []
    found = run_chart(dataset, models, names=names, budget=budget, log=note)
    command = f"slipflow chart {found.dataset}{method_options(models, names)} --budget {budget:g}"
    write_report(chart_report(found, command), out, "chart", as_json=as_json)
