"""The command `slipflow simulate`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.options import Cluster, Jobs, Seed
from flows.cli.terminal import progress_bar


def simulate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of the dataset, new or empty.")],
    *,
    plan: Annotated[
        str,
        typer.Option(
            help="Plan: paper (50 minutes), wide (56 minutes, many materials), slow (44 minutes, strokes at 4"
            " to 20 mm/s), calm (79 minutes, quiet hands, other fingertips), grasps (107 minutes, 1,000"
            " objects, labelled by true sliding) or tiny (2 minutes)."
        ),
    ] = "paper",
    seed: Seed = 0,
    jobs: Jobs = None,
    cluster: Cluster = None,
) -> None:
    """Simulate a collection plan as a labelled dataset.

    The sessions are split for training, validation and testing.

    Examples:
      slipflow simulate recordings --plan tiny --seed 1
      slipflow simulate recordings --jobs 2
    """
    from collections import Counter

    from flows.lab import simulation
    from flows.learn.labelled_recordings import SPLITS
    from flows.run.executor import workers

    with workers(jobs, cluster) as executor, progress_bar(f"simulating {plan}") as update:
        simulation.simulate(out, plan, seed, executor=executor, progress=update)
    counts = Counter(each.split for each in simulation.planned_recordings(plan, seed))
    parts = ", ".join(f"{counts[split]} for {split}" for split in SPLITS)
    typer.echo(f"{out}: {counts.total()} sessions ({parts})")
