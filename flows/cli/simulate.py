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
    from collections import Counter

    from flows.lab import simulation
    from flows.learn.labelled_recordings import SPLITS
    from flows.run.executor import workers

    with workers(jobs, cluster) as executor, progress_bar(f"simulating {plan}") as update:
        simulation.simulate(out, plan, seed, executor=executor, progress=update)
    counts = Counter(each.split for each in simulation.planned_recordings(plan, seed))
    splits = {split: counts[split] for split in SPLITS}
    if as_json:
        typer.echo(json.dumps({"dataset": str(out), "plan": plan, "seed": seed, "sessions": splits}))
    else:
        parts = ", ".join(f"{count} for {split}" for split, count in splits.items())
        typer.echo(f"{out}: {counts.total()} sessions ({parts})")
