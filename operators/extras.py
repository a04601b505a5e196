"""Installed software: slipflow's version, and extras, which are optional packages."""

import json
from collections.abc import Mapping
from functools import cache
from importlib.metadata import distribution, version
from importlib.util import find_spec
from types import MappingProxyType
from typing import Final, NamedTuple

from operators.checks import check_choice
from operators.errors import InputError


class Extra(NamedTuple):
    """Optional package, as `pyproject.toml` declares it."""

    use: str
    package: str
    module: str  # that is imported


EXTRAS: Final[Mapping[str, Extra]] = MappingProxyType(
    {
        "train": Extra("training of detectors", "torch", "torch"),
        "baselines": Extra("comparison with logistic regression", "scikit-learn", "sklearn"),
        "ur": Extra("driving a UR arm, on x86_64 with Python 3.11 or 3.12 only", "ur-rtde", "rtde_control"),
        "gripper": Extra("Robotiq grippers", "pymodbus", "pymodbus"),
        "report": Extra("figures in reports", "matplotlib", "matplotlib"),
        "mcap": Extra("export to MCAP files", "mcap", "mcap"),
        "fetch": Extra("download of public datasets", "pooch", "pooch"),
        "cluster": Extra("replays and studies on several machines", "distributed", "distributed"),
    }
)


@cache
def software_version() -> str:
    """Return the version of the installed slipflow; reading it takes 1 ms."""
    return version("slipflow")


def is_installed(extra: str) -> bool:
    """Return whether the package of an extra is installed."""
    return find_spec(EXTRAS[extra].module) is not None


def install_command(extra: str) -> str:
    """Return the command that installs an extra, in a clone or from a wheel."""
    origin = json.loads(distribution("slipflow").read_text("direct_url.json") or "{}")
    clone = origin.get("dir_info", {}).get("editable", False)
    return f"in the clone, pip install -e '.[{extra}]'" if clone else f"pip install 'slipflow[{extra}]'"


def require_extra(extra: str, owner: str) -> None:
    """Require that the package of an extra is installed.

    Raises:
        InputError: naming `owner`, if it is missing; the message contains the command that installs it.
        ParameterError: if there is no such extra.
    """
    check_choice(owner, "extra", extra, EXTRAS)
    if not is_installed(extra):
        raise InputError(owner, f"needs {EXTRAS[extra].package}: {install_command(extra)}")
