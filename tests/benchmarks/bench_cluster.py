"""Replays on a Dask cluster on this machine, relative to one process.

The flow `relabel` replays recordings of many fingertips: in one process, then on a cluster with one worker
and with two. The start of a job is the time for one short recording. All outputs must be the same bytes.
"""

import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter

from flows.run.executor import workers
from flows.run.replays import FlowSource, Replays
from storage.layout import session_folders
from tests.benchmarks.machine import print_head
from tests.dask_cluster import DaskCluster
from tests.flows.run.recorder import Recorder
from tests.storage.made import contents

SESSIONS, SECONDS, TURNS = 8, 600, 3  # seconds of each session


def replay(paths: list[Path], out: Path, cluster: str | None) -> float:
    """Replay recordings and return the time it took, s."""
    began = perf_counter()
    with workers(None if cluster else 1, cluster) as executor:
        found = list(Replays(FlowSource("relabel", (("out", str(out)),)), paths).run(executor))
    if errors := [each.error for each in found if each.error]:
        raise SystemExit(errors[0])
    return perf_counter() - began


def main() -> None:
    """Measure and print a table."""
    samples = SESSIONS * SECONDS * 100 * 8
    print_head(f"{SESSIONS} sessions, {samples:,} samples of 8 fingertips, medians of {TURNS} turns")
    print(f"{'':16}{'start, s':>10}{'all, s':>10}{'samples/s':>12}{'relative':>10}{'same bytes':>12}")
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for number, seconds in enumerate([1, *[SECONDS] * SESSIONS]):
            recorder = Recorder(root / "in", f"s{number:02d}", seed=number)
            recorder.record(seconds, tuple(range(8)))
            recorder.close()
        short, *long = session_folders(root / "in")
        replay([short], root / "first", None)  # compiles
        speeds, expected = dict[int, float](), dict[str, bytes]()
        with DaskCluster(root) as cluster:
            for count in (0, 1, 2):
                url = cluster.url if count else None
                if count:
                    cluster.add_worker()
                    cluster.wait(count)
                    replay(long[:2], root / f"warm-{count}", url)
                walls, starts = list[float](), list[float]()
                for turn in range(TURNS):
                    out = root / f"{count}-{turn}"
                    starts.append(replay([short], out / "short", url))
                    walls.append(replay(long, out / "long", url))
                written = contents(root / f"{count}-0" / "long")
                expected = expected or written
                speeds[count] = samples / median(walls)
                name = f"{count} Dask workers" if count else "one process"
                print(f"{name:16}{median(starts):10.1f}{median(walls):10.1f}{speeds[count]:12.0f}", end="")
                print(f"{speeds[count] / speeds[0]:10.2f}{written == expected!s:>12}", flush=True)


if __name__ == "__main__":
    main()
