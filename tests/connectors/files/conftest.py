"""Fixture of the tests of files."""

from collections.abc import Callable
from pathlib import Path

import pytest

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_lines(*lines: str, end: str = "\n") -> Path:
        path = tmp_path / "trace.csv"
        path.write_text("\n".join(lines) + end, encoding="utf-8")
        return path

    return write_lines
