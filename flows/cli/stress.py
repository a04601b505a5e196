"""The command `slipflow stress`."""

from pathlib import Path

from flows.cli.options import AsJson, Jobs, Methods, Models, Seed
from flows.cli.report_output import ReportFolder, method_options, prepare_report, write_report
from flows.cli.terminal import note, progress_bar


def stress(
    *,
    model: Models = None,
    method: Methods = None,
    seed: Seed = 4000,
    jobs: Jobs = None,
    out: ReportFolder = Path("stress"),
    as_json: AsJson = False,
) -> None:
    """Find the level of each stress at which each detector fails.

    Simulates every stress from nominal to broken, which takes minutes. Writes stress.html, .md, .json and
    figures. Needs the train extra.

    Examples:
      slipflow stress --method tcn --method psd --jobs 2
    """
    from flows.learn.stress.stress_report import stress_report
    from flows.learn.stress.stress_study import stress as run_stress

    prepare_report(out)
    models, names = model or [], method or []
    with progress_bar("stress") as update:
        found = run_stress(models, names=names, seed=seed, jobs=jobs, log=note, progress=update)
    command = f"slipflow stress{method_options(models, names)} --seed {seed}"
    write_report(stress_report(found, command), out, "stress", as_json=as_json)
