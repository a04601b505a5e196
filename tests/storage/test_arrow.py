"""Tests of the lazy import of pyarrow."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
import sys
from storage.arrow import load, pa
assert "pyarrow" not in sys.modules
load()
print(pa.default_memory_pool().backend_name)
"""


@pytest.mark.parametrize(
    ("chosen", "used"), [({}, "system"), ({"ARROW_DEFAULT_MEMORY_POOL": "mimalloc"}, "mimalloc")]
)
def test_arrow_takes_memory_from_the_c_library_unless_another_allocator_is_chosen(
    chosen: dict[str, str], used: str
) -> None:
    others = {name: value for name, value in os.environ.items() if name != "ARROW_DEFAULT_MEMORY_POOL"}
    found = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=others | chosen, capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == used
