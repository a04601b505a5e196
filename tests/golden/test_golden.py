"""The studies give the numbers of golden.json, which the code before the redesign printed."""

import json
from collections.abc import Iterator
from math import isnan
from pathlib import Path
from typing import Any

import pytest

from tests.golden.values import every_value

GOLDEN = json.loads(Path(__file__).with_name("golden.json").read_text())


@pytest.fixture(scope="module")
def values(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return every_value(tmp_path_factory.mktemp("golden"))


def leaves(value: object, path: str = "") -> Iterator[tuple[str, object]]:
    """Yield each number, string or null with its place; NaN counts as null."""
    if isinstance(value, dict | list):
        for key, each in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(each, f"{path}/{key}")
    else:
        yield path, None if isinstance(value, float) and isnan(value) else value


@pytest.mark.parametrize("study", GOLDEN)
def test_a_study_gives_the_same_numbers_as_ever(values: dict[str, Any], study: str) -> None:
    expected, found = dict(leaves(GOLDEN[study])), dict(leaves(values[study]))
    assert found.keys() == expected.keys()
    for place, value in expected.items():
        close = pytest.approx(value, rel=1e-9, abs=1e-9) if isinstance(value, float) else value
        assert found[place] == close, place
