import re
import tomllib
from itertools import chain
from pathlib import Path
from types import SimpleNamespace

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from operators import extras
from operators.extras import EXTRAS, install_command

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]


def test_each_extra_for_users_has_a_use_and_a_package() -> None:
    declared = {
        extra: {re.split("[<>=]", line)[0] for line in lines}
        for extra, lines in PROJECT["optional-dependencies"].items()
        if extra not in {"dev", "docs"}
    }
    assert {extra: {each.package} for extra, each in EXTRAS.items()} == declared


@pytest.mark.parametrize(
    ("origin", "command"),
    [
        (None, "pip install 'slipflow[gripper]'"),
        ('{"url": "file:///x", "dir_info": {"editable": true}}', "in the clone, pip install -e '.[gripper]'"),
    ],
)
def test_the_install_command_fits_a_wheel_or_a_clone(
    monkeypatch: pytest.MonkeyPatch, origin: str | None, command: str
) -> None:
    monkeypatch.setattr(extras, "distribution", lambda _: SimpleNamespace(read_text=lambda _: origin))
    assert install_command("gripper") == command


# first releases without the advisories that were published up to November 2026
SAFE = {"aiohttp": "3.13.4", "jinja2": "3.1.6", "mkdocs-material": "9.5.32", "torch": "2.10"}


def test_no_release_with_a_published_advisory_is_allowed() -> None:
    every = [*PROJECT["dependencies"], *chain.from_iterable(PROJECT["optional-dependencies"].values())]
    allowed = {found.name: found.specifier for found in map(Requirement, every)}
    for package, release in SAFE.items():
        assert Version(release) in allowed[package]
        assert not any(Version(each) in allowed[package] for each in (f"{release}rc1", "1.0"))
