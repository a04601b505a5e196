"""Write requirements.txt, edge.txt and build.txt with the newest versions and the hashes of their files.

Run after changing dependencies: .venv/bin/python deploy/pin_requirements.py. It downloads metadata only.
"""  # noqa: INP001 - a script, not a package

import json
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
EDGE_WITHOUT = ("numba", "polars", "scipy")  # not needed at the edge
PYTHONS = ("3.11", "3.13")  # Debian 12 and 13
# minor versions of glibc 2 in manylinux tags, by machine
GLIBC = {"x86_64": (5, 12, 17, 27, 28), "aarch64": (17, 27, 28)}

ALL = "# All dependencies, also of the extra cluster, for x86_64 and aarch64 with Python 3.11 or 3.13."
EDGE = "# Dependencies of one fingertip that publishes and records: without numba, polars and scipy."
BUILD = "# Build tools of the wheel."


def resolve(wanted: Sequence[str], python: str, machine: str) -> list[dict[str, Any]]:
    """Return the packages that pip would install for a Python version and machine."""
    platforms = [f"manylinux_2_{minor}_{machine}" for minor in GLIBC[machine]] + [f"manylinux2014_{machine}"]
    platform_options = [word for each in platforms for word in ("--platform", each)]
    options = ["--quiet", "--dry-run", "--ignore-installed", "--report", "-"]
    target = ["--only-binary", ":all:", "--implementation", "cp", "--python-version", python, "--target", "."]
    done = subprocess.run(  # noqa: S603 - fixed arguments
        [sys.executable, "-m", "pip", "install", *options, *target, *platform_options, *wanted],
        stdout=subprocess.PIPE,
        check=True,
    )
    report: dict[str, Any] = json.loads(done.stdout)
    return list(report["install"])


def pins(wanted: Sequence[str]) -> dict[str, set[str]]:
    """Return the hashes of each package==version, with one version for all platforms."""
    found = dict[str, set[str]]()
    for python in PYTHONS:
        for machine in GLIBC:
            for each in resolve([*wanted, *found], python, machine):
                about = each["metadata"]
                pin = f"{about['name'].lower().replace('_', '-')}=={about['version']}"
                found.setdefault(pin, set()).add(each["download_info"]["archive_info"]["hashes"]["sha256"])
    return found


def write(name: str, title: str, found: dict[str, set[str]]) -> None:
    """Write a file for `pip install --require-hashes -r`."""
    lines = [title]
    for pin, hashes in sorted(found.items()):
        lines.append(" \\\n".join([pin, *(f"    --hash=sha256:{each}" for each in sorted(hashes))]))
    (HERE / name).write_text("\n".join([*lines, ""]), encoding="utf-8")


def main() -> None:
    """Write the three files."""
    project = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    wanted: list[str] = project["project"]["dependencies"]
    everything = pins([*wanted, *project["project"]["optional-dependencies"]["cluster"]])
    small = pins([each for each in wanted if not each.startswith(EDGE_WITHOUT)])
    write("requirements.txt", ALL, everything)
    write("edge.txt", EDGE, {pin: everything[pin] for pin in small})
    write("build.txt", BUILD, pins(project["build-system"]["requires"]))


if __name__ == "__main__":
    main()
