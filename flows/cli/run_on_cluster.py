"""Replay of recordings on a Flink cluster: `slipflow run --cluster`."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from flows.cli.terminal import note, progress_bar
from flows.report.table import counted

ClusterUrl = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="URL",
        help="With --replay: run on this Flink cluster, such as http://localhost:8081 (`make cluster` starts"
        " one).",
    ),
]
Follow = Annotated[
    bool,
    typer.Option("--follow", help="With --cluster: continue with new recordings until --for or Ctrl-C."),
]
PythonFile = Annotated[
    Path | None,
    typer.Option(
        "--cluster-python",
        metavar="FILE",
        help="With --cluster: Python that has pyflink and slipflow (default: this one, else"
        " .cluster/bin/python).",
    ),
]


def run_on_cluster(
    url: str,
    python: Path | None,
    target: str,
    settings: Mapping[str, str],
    recordings: Sequence[Path],
    *,
    job: str,
    follow: bool,
    limit: int | None,
    as_json: bool,
) -> None:
    """Replay recordings on a Flink cluster, each to a session of the same name.

    With `follow`, stop after `limit` ns. Exits 1 if a replay failed, 130 if interrupted.
    """
    from time import monotonic

    from flows.graph.loading import load
    from flows.run.cluster.cluster_replay import Cluster
    from flows.run.stop_signals import stopping

    if not recordings:
        raise typer.BadParameter("--cluster requires --replay PATH: the recordings to replay")
    if limit is not None and not follow:
        raise typer.BadParameter("--for requires --follow with --cluster: else the job ends with the replays")
    began = monotonic()
    cluster = Cluster(url, python)
    with stopping() as stopped, progress_bar(f"{target} on {url}") as update:
        done = cluster.run(
            job,
            load(target),
            settings,
            recordings,
            follow=follow,
            stopped=lambda: stopped() or (limit is not None and (monotonic() - began) * 1e9 >= limit),
            progress=update,
        )
        interrupted = stopped() and not follow
    failed = {name: error for name, error in done.items() if error}
    for name, error in failed.items():
        note(f"error: {name}: {error}")
    seconds = monotonic() - began
    if as_json:
        sessions = [{"session": name, "error": error or None} for name, error in done.items()]
        typer.echo(json.dumps({"job": cluster.job, "sessions": sessions, "wall_seconds": seconds}))
    else:
        written = counted(len(done) - len(failed), "session")
        typer.echo(f"wrote {written}, {len(failed)} failed, in {seconds:.1f} s; Flink job {cluster.job}")
    if interrupted:
        raise typer.Exit(130)
    if failed:
        raise typer.Exit(1)
