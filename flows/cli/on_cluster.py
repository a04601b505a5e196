"""What `slipflow run --cluster` does; `flows.cli.run` calls it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from flows.cli.options import counted, progress_bar, told

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

OnCluster = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="URL",
        help="With --replay: on this Flink cluster, as http://localhost:8081; `make cluster` starts one.",
    ),
]
Follow = Annotated[
    bool,
    typer.Option("--follow", help="With --cluster: go on with what is recorded meanwhile, until Ctrl-C."),
]
WithPython = Annotated[
    Path | None,
    typer.Option(
        "--cluster-python",
        metavar="FILE",
        help="With --cluster: the Python with pyflink and slipflow; else this one, or .cluster/bin/python.",
    ),
]


@dataclass(frozen=True)
class Place:
    """The cluster that is to do it, as the options say."""

    url: str
    python: Path | None
    follow: bool = field(kw_only=True)
    limit: int | None = field(kw_only=True)  # ns

    def run(
        self,
        target: str,
        settings: Mapping[str, str],
        recordings: Sequence[Path],
        session: str,
        *,
        as_json: bool,
    ) -> None:
        """Run a flow over recordings; each becomes a session of its own name, `session` names the job.

        Exits 1 if one of them failed, 130 if it was interrupted.
        """
        from time import monotonic

        from flows.graph.loading import load
        from flows.run.cluster.cluster_replay import Cluster
        from flows.run.stop_signals import stopping

        if not recordings:
            raise typer.BadParameter("--cluster needs --replay PATH: what is to be run over")
        if self.limit is not None and not self.follow:
            raise typer.BadParameter("--for needs --follow with --cluster: else it ends when all is replayed")
        began = monotonic()
        cluster = Cluster(self.url, self.python)
        with stopping() as stopped, progress_bar(f"{target} on {self.url}") as update:
            done = cluster.run(
                session,
                load(target),
                settings,
                recordings,
                follow=self.follow,
                stopped=lambda: stopped() or self._over(began),
                progress=update,
            )
            interrupted = stopped() and not self.follow
        failed = {name: error for name, error in done.items() if error}
        for name, error in failed.items():
            told(f"error: {name}: {error}")
        seconds = monotonic() - began
        if as_json:
            sessions = [{"session": name, "error": error or None} for name, error in done.items()]
            typer.echo(json.dumps({"job": cluster.job, "sessions": sessions, "wall_seconds": seconds}))
        else:
            written = counted(len(done) - len(failed), "session")
            typer.echo(
                f"{written} written, {len(failed)} failed, in {seconds:.1f} s; Flink's job {cluster.job}"
            )
        if interrupted:
            raise typer.Exit(130)
        if failed:
            raise typer.Exit(1)

    def _over(self, began: float) -> bool:
        """Whether the time has passed that it was to last."""
        from time import monotonic

        return self.limit is not None and (monotonic() - began) * 1e9 >= self.limit
