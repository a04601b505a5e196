"""Size and memory of what runs at the fingertip: an install of deploy/edge.txt, one fingertip at 100 Hz.

Run by `make bench`. A fresh environment is made, or the one named by --python is taken, in which
deploy/fingertip.py runs: `TakkTile` reads an emulated bus (in the same process, and so in what is measured)
whose fingertip feels what a simulated one felt; the trained `Score`, `Debounce` and `Health` follow; events
go to a mosquitto with the shipped configuration, and in a second run with what was received to a dataset,
too. The goals: below 400 MB installed, below 150 MB of memory.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from connectors.sim.finger import Finger
from connectors.sim.scene import Scene
from operators import Touch
from tests.benchmarks.machine import commit, machine
from tests.connectors.mqtt.broker_process import TestBroker
from tests.deploy.shipped import DEPLOY, PASSWORDS, shipped_broker

ROOT: Final = DEPLOY.parent
FELT: Final = 60.0  # s, then it begins again
INSTALLED, RESIDENT = 400, 150  # MB, the goals


def felt() -> Touch:
    """What a simulated fingertip feels: presses and strokes."""
    taken = Finger(Scene(), 0).take(round(FELT * 100))
    assert taken is not None
    return taken[0]


def install(folder: Path) -> Path:
    """An environment as docs/how-to/deploy.md makes it; gives its Python."""
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    python = folder / "bin" / "python"
    pip += ["--python", str(python), "install", "--no-cache-dir"]
    lock = str(DEPLOY / "edge.txt")
    subprocess.run([*pip, "--require-hashes", "--only-binary", ":all:", "-r", lock], check=True)
    subprocess.run([*pip, "--no-deps", str(ROOT)], check=True)
    return python


def size(folder: Path) -> float:
    """What files take on the disk, MB (of 10^6 bytes)."""
    return sum(each.lstat().st_blocks * 512 for each in folder.rglob("*") if not each.is_dir()) / 1e6


def largest(python: Path, count: int = 6) -> list[tuple[str, float]]:
    """The largest packages of an environment, MB."""
    [packages] = (python.parent.parent / "lib").glob("python*/site-packages")
    sizes = [(each.name, size(each)) for each in packages.iterdir() if each.is_dir()]
    return sorted(sizes, key=lambda each: -each[1])[:count]


def work(python: Path, table: Path, broker: TestBroker, seconds: float, out: Path | None) -> dict[str, Any]:
    """One run in that environment, by itself."""
    settings = [f"broker={broker.url}", *([f"out={out}"] if out else [])]
    words = [str(DEPLOY / "fingertip.py"), str(table), "--seconds", str(seconds)]
    words += [word for each in settings for word in ("--set", each)]
    login = {"SLIPFLOW_MQTT_USER": "fingertip", "SLIPFLOW_MQTT_PASSWORD": PASSWORDS["fingertip"]}
    place = {"XDG_STATE_HOME": str(table.parent / "state"), "OPENBLAS_NUM_THREADS": "1"}
    child = ROOT / "tests" / "benchmarks" / "edge_child.py"
    done = subprocess.run(
        [python, child, *words],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        cwd=table.parent,  # so that the environment's slipflow runs, not the clone's
        env={**os.environ, **login, **place},
    )
    return cast("dict[str, Any]", json.loads(done.stdout.splitlines()[-1]))


def report(python: Path, runs: dict[str, dict[str, Any]]) -> str:
    """The tables."""
    whole = size(python.parent.parent)
    lines = [f"{'installed':24}{whole:8.0f} MB of {INSTALLED}: {'met' if whole < INSTALLED else 'MISSED'}"]
    lines += [f"  {name:22}{each:8.0f} MB" for name, each in largest(python)]
    lines.append(
        f"{'one fingertip':24}{'MB':>8}{'peak':>8}{'CPU':>8}{'rows':>8}{'missed':>8}{'events':>8}{'lost':>6}"
    )
    for name, run in runs.items():
        lost = sum(dropped for _, dropped in run["sinks"].values())
        memory = f"{run['rss'][1]:8.0f}{run['peak']:8.0f}{run['cpu']:8.1%}"
        rows = f"{run['rows']:8}{run['scans']['missed']:8}{run['sinks']['mqtt'][0]:8}{lost:6}"
        met = "met" if run["peak"] < RESIDENT else "MISSED"
        lines.append(
            f"{name:24}{memory}{rows}  below {RESIDENT} MB: {met}; loaded {', '.join(run['loaded'])}"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=40.0, help="of each run")
    parser.add_argument("--python", type=Path, help="of an environment to measure instead of a fresh one")
    options = parser.parse_args()
    print(f"{options.seconds:.0f} s each, commit {commit()}")
    print(f"{machine()}, numpy {np.__version__}")
    print(f"load {os.getloadavg()[0]:.1f} at the beginning")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        python = options.python.absolute() if options.python else install(folder / "environment")
        touch, table = felt(), folder / "felt.npz"
        np.savez(table, counts=touch.counts, temperature=touch.temperature)
        broker = shipped_broker(folder)
        try:
            runs = {
                kind: work(python, table, broker, options.seconds, out)
                for kind, out in (("publishing", None), ("and recording", folder / "recordings"))
            }
        finally:
            broker.close()
        print(report(python, runs))


if __name__ == "__main__":
    main()
