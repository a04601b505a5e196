import re
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.deploy.shipped import DEPLOY

FILES = ("requirements.txt", "edge.txt", "build.txt")
PROJECT = tomllib.loads((DEPLOY.parent / "pyproject.toml").read_text())
LEFT_OUT = {"numba", "polars", "scipy"}  # of a small install: the flow at the edge works without


def pins(name: str) -> dict[str, tuple[str, list[str]]]:
    """Version and hashes of each package."""
    text = "\n".join(line for line in (DEPLOY / name).read_text().splitlines() if not line.startswith("#"))
    found = re.findall(r"^(\S+)==(\S+)((?: \\\n {4}--hash=sha256:[0-9a-f]{64})+)$", text, re.MULTILINE)
    assert len(found) == text.count("==") == len({package for package, _, _ in found})
    return {package: (version, re.findall(r"[0-9a-f]{64}", hashes)) for package, version, hashes in found}


@pytest.mark.parametrize("name", FILES)
def test_every_package_has_one_version_and_hashes(name: str) -> None:
    assert pins(name)


@pytest.mark.parametrize(("name", "without"), [("requirements.txt", set[str]()), ("edge.txt", LEFT_OUT)])
def test_the_versions_satisfy_the_project(name: str, without: set[str]) -> None:
    found, asked = pins(name), [Requirement(each) for each in PROJECT["project"]["dependencies"]]
    assert {canonicalize_name(each.name) for each in asked} - set(found) == without
    for each in asked:
        if each.name not in without:
            assert each.specifier.contains(found[canonicalize_name(each.name)][0]), each


def test_the_build_tools_satisfy_the_project() -> None:
    [asked] = [Requirement(each) for each in PROJECT["build-system"]["requires"]]
    assert asked.specifier.contains(pins("build.txt")[asked.name][0])


def test_the_edge_has_the_same_versions() -> None:
    everything = pins("requirements.txt")
    assert {name: everything[name] for name in pins("edge.txt")} == pins("edge.txt")
