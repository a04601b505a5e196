"""The command `slipflow simulate`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from flows.cli.options import AsJson, Cluster, Jobs, Seed
from flows.cli.terminal import progress_bar


def simulate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of the dataset, new or empty.")],
    *,
    plan: Annotated[
        str,
        typer.Option(
            help="Plan: paper (44 minutes), wide (30 minutes, 30 materials), slow (23 minutes, strokes at"
            " 4 to 20 mm/s), grasps (25 minutes, 300 objects, labelled by true sliding) or tiny (2 minutes)."
        ),
    ] = "paper",
    seed: Seed = 0,
    jobs: Jobs = None,
    cluster: Cluster = None,
    as_json: AsJson = False,
) -> None:
    """Simulate a collection plan as a labelled dataset.

    The sessions are split for training, validation and testing.

    Examples:
      slipflow simulate recordings --plan tiny --seed 1
      slipflow simulate recordings --jobs 2
    """
    from flows.lab import simulation
    from flows.run.executor import workers

    with workers(jobs, cluster) as executor, progress_bar(f"simulating {plan}") as update:
        done = simulation.simulate(out, plan, seed, executor=executor, progress=update)
    typer.echo(json.dumps(done.json()) if as_json else done.text())
