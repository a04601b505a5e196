"""Write requirements.txt, edge.txt and build.txt anew: the newest versions, and the hashes of their files.

Run it after a dependency changed: .venv/bin/python deploy/lock.py. It downloads descriptions only.
"""  # noqa: INP001 - no package: it is run by its path

import json
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
LEFT_OUT = ("numba", "polars", "scipy")  # at the edge: the flow there works without
PYTHONS = ("3.11", "3.13")  # Debian 12 and 13
GLIBC = {
    "x86_64": (5, 12, 17, 27, 28),
    "aarch64": (17, 27, 28),
}  # 2.x, the newest that Debian 12 and wheels have

ALL = "# All that the project depends on, on x86_64 and aarch64 with Python 3.11 or 3.13."
EDGE = "# What one fingertip needs, to be published and recorded: not numba, polars and scipy."
BUILD = "# What makes the wheel."


def resolve(wanted: Sequence[str], python: str, machine: str) -> list[dict[str, Any]]:
    """What pip would install there."""
    platforms = [f"manylinux_2_{minor}_{machine}" for minor in GLIBC[machine]] + [f"manylinux2014_{machine}"]
    where = [word for each in platforms for word in ("--platform", each)]
    pip = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--dry-run",
        "--ignore-installed",
        "--report",
        "-",
    ]
    there = ["--only-binary", ":all:", "--implementation", "cp", "--python-version", python, "--target", "."]
    done = subprocess.run([*pip, *there, *where, *wanted], stdout=subprocess.PIPE, check=True)  # noqa: S603 - ours
    report: dict[str, Any] = json.loads(done.stdout)
    return list(report["install"])


def pins(wanted: Sequence[str]) -> dict[str, set[str]]:
    """The hashes of each package==version, the same version everywhere."""
    found = dict[str, set[str]]()
    for python in PYTHONS:
        for machine in GLIBC:
            for each in resolve([*wanted, *found], python, machine):
                about = each["metadata"]
                pin = f"{about['name'].lower().replace('_', '-')}=={about['version']}"
                found.setdefault(pin, set()).add(each["download_info"]["archive_info"]["hashes"]["sha256"])
    return found


def write(name: str, title: str, found: dict[str, set[str]]) -> None:
    """One file, as `pip install --require-hashes -r` takes it."""
    lines = [title]
    for pin, hashes in sorted(found.items()):
        lines.append(" \\\n".join([pin, *(f"    --hash=sha256:{each}" for each in sorted(hashes))]))
    (HERE / name).write_text("\n".join([*lines, ""]), encoding="utf-8")


def main() -> None:
    """Write them."""
    project = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    wanted: list[str] = project["project"]["dependencies"]
    everything = pins(wanted)
    small = pins([each for each in wanted if not each.startswith(LEFT_OUT)])
    write("requirements.txt", ALL, everything)
    write("edge.txt", EDGE, {pin: everything[pin] for pin in small})
    write("build.txt", BUILD, pins(project["build-system"]["requires"]))


if __name__ == "__main__":
    main()
