import os
import re
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest

from operators import InputError, extras
from operators.extras import EXTRAS, install_command, missing_packages, require_extra, requirements

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]


def test_each_extra_for_users_has_a_use_and_packages() -> None:
    assert set(PROJECT["optional-dependencies"]) - {"dev", "docs"} == set(EXTRAS)
    declared = {
        extra: {re.split("[<>=]", line)[0] for line in lines}
        for extra, lines in PROJECT["optional-dependencies"].items()
    }
    for extra in EXTRAS:
        assert {each.package for each in requirements() if each.extra == extra} == declared[extra]


def from_wheel(_: str) -> object:
    return SimpleNamespace(read_text=dict[str, str]().get)


def from_clone(_: str) -> object:
    origin = '{"url": "file:///x", "dir_info": {"editable": true}}'
    return SimpleNamespace(read_text={"direct_url.json": origin}.get)


def test_the_install_command_fits_a_wheel_or_a_clone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "distribution", from_wheel)
    assert install_command("gripper") == "pip install 'slipflow[gripper]'"
    monkeypatch.setattr(extras, "distribution", from_clone)
    assert install_command("gripper") == "in the clone, pip install -e '.[gripper]'"


@pytest.mark.parametrize(
    ("machine", "python", "told"),
    [
        ("x86_64", (3, 12), "pip install 'slipflow[ur]'"),
        ("x86_64", (3, 13), "no release for Python 3.13 on x86_64: use Python 3.11 or 3.12 on x86_64 Linux"),
        (
            "aarch64",
            (3, 11),
            "no release for Python 3.11 on aarch64: use Python 3.11 or 3.12 on x86_64 Linux",
        ),
    ],
)
def test_no_command_is_given_where_an_extra_has_no_packages(
    monkeypatch: pytest.MonkeyPatch, machine: str, python: tuple[int, int], told: str
) -> None:
    monkeypatch.setattr(extras, "distribution", from_wheel)
    monkeypatch.setattr(os, "uname", lambda: SimpleNamespace(machine=machine))
    monkeypatch.setattr(sys, "version_info", python)
    assert install_command("ur") == told


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "distribution", from_wheel)
    monkeypatch.setattr(extras, "requirements", lambda: (extras.Requirement("nothing-like-it", "", "ros"),))
    assert missing_packages("ros") == ["nothing-like-it"]
    with pytest.raises(InputError, match=r"^import: needs nothing-like-it: pip install 'slipflow\[ros\]'$"):
        require_extra("ros", "import")
