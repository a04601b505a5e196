"""Extras: groups of optional packages, as declared in slipflow's package metadata."""

import json
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution, requires, version
from types import MappingProxyType
from typing import Final

from operators.errors import InputError

EXTRAS: Final[Mapping[str, str]] = MappingProxyType(  # use of each extra
    {
        "train": "training, evaluation and ONNX export of detectors",
        "ur": "driving a UR arm",
        "gripper": "Robotiq grippers",
        "report": "figures in reports",
        "mcap": "export to MCAP files",
        "fetch": "download of public datasets",
        "rerun": "export to Rerun",
        "cluster": "work on a Dask cluster",
    }
)
_LIMITS: Final = {"ur": ("x86_64", (3, 13))}  # machine, and first Python without its packages
_REQUIREMENT: Final = re.compile(r"([\w.-]+)[^<>=!~;]*([^;]*)(?:;.*extra == ['\"](\w+)['\"])?")
_BOUND: Final = re.compile(r"(>=|<)\s*([\d.]+)")


@dataclass(frozen=True)
class Requirement:
    """Package that slipflow needs.

    Attributes:
        package: Name of the package.
        versions: Accepted versions, such as ``>=2,<3``.
        extra: Extra that the package belongs to; empty: always needed.
    """

    package: str
    versions: str
    extra: str = ""

    @property
    def installed(self) -> str | None:
        """Installed version; None: not installed."""
        try:
            return version(self.package)
        except PackageNotFoundError:
            return None

    @property
    def satisfied(self) -> bool:
        """True if an accepted version is installed."""
        found = self.installed
        return found is not None and accepts(self.versions, found)


def accepts(versions: str, found: str) -> bool:
    """Return True if a version is in a range.

    >>> accepts(">=2.5.1,<3", "2.10"), accepts(">=2.5.1,<3", "3.0.1"), accepts(">=2.5.1", "2.5.1rc1")
    (True, False, True)
    """
    release = _numbers(found)
    bounds = [(sign, _numbers(bound)) for sign, bound in _BOUND.findall(versions)]
    return all((release >= bound) == (sign == ">=") for sign, bound in bounds)


def _numbers(release: str) -> tuple[int, ...]:
    """Return the numbers of a version without trailing zeros, so that 3 equals 3.0."""
    match = re.match(r"\d+(?:\.\d+)*", release)
    text = re.sub(r"(\.0+)+$", "", match[0]) if match else "0"
    return tuple(map(int, text.split(".")))


@cache
def requirements() -> tuple[Requirement, ...]:
    """Return the packages that slipflow and its extras need."""
    matches = [_REQUIREMENT.match(line) for line in requires("slipflow") or ()]
    return tuple(Requirement(m[1], m[2].strip(), m[3] or "") for m in matches if m)


def missing_packages(extra: str) -> list[str]:
    """Return the packages of an extra that are not installed."""
    return [each.package for each in requirements() if each.extra == extra and each.installed is None]


def install_command(extra: str) -> str:
    """Return the command that installs an extra, in a clone or from a wheel; else why there is none here."""
    machine, end = _LIMITS.get(extra, ("", (4, 0)))
    here, running = os.uname().machine, sys.version_info[:2]
    if running >= end or machine not in ("", here):
        python = ".".join(map(str, running))
        return f"no release for Python {python} on {here}: use Python 3.11 or 3.12 on {machine} Linux"
    origin = json.loads(distribution("slipflow").read_text("direct_url.json") or "{}")
    clone = origin.get("dir_info", {}).get("editable", False)
    return f"in the clone, pip install -e '.[{extra}]'" if clone else f"pip install 'slipflow[{extra}]'"


def require_extra(extra: str, owner: str) -> None:
    """Require that the packages of an extra are installed.

    Raises:
        InputError: naming `owner`, if one is missing; the message contains the command that installs them.
    """
    if missing := missing_packages(extra):
        raise InputError(owner, f"needs {', '.join(missing)}: {install_command(extra)}")
