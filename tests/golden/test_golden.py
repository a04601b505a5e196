"""The studies give the numbers of golden.json: `tests.golden.values` prints them in this environment."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

GOLDEN = json.loads(Path(__file__).with_name("golden.json").read_text())
GENERIC: Final = {  # instructions of all x86-64 processors: with others, sums round differently
    "NUMBA_CPU_NAME": "generic",
    "NUMBA_CPU_FEATURES": "",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "OPENBLAS_CORETYPE": "Nehalem",
    "ATEN_CPU_CAPABILITY": "default",
}


@pytest.fixture(scope="module")
def values() -> dict[str, Any]:
    command = [sys.executable, "-m", "tests.golden.values"]
    found = subprocess.run(
        command, check=True, stdout=subprocess.PIPE, text=True, env={**os.environ, **GENERIC}
    )
    result: dict[str, Any] = json.loads(found.stdout)
    return result


def leaves(value: object, path: str = "") -> Iterator[tuple[str, object]]:
    """Yield each number, string or null with its place."""
    if isinstance(value, dict | list):
        for key, each in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(each, f"{path}/{key}")
    else:
        yield path, value


@pytest.mark.parametrize("study", GOLDEN)
def test_a_study_gives_the_same_numbers_as_ever(values: dict[str, Any], study: str) -> None:
    expected, found = dict(leaves(GOLDEN[study])), dict(leaves(values[study]))
    assert found.keys() == expected.keys()
    for place, value in expected.items():
        close = pytest.approx(value, rel=1e-9, abs=1e-9) if isinstance(value, float) else value
        assert found[place] == close, place
