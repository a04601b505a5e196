import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core import caching
from numba.core.registry import CPUDispatcher

from operators import compilation, row_loop
from operators.compilation import compile_function


def test_a_function_is_compiled_where_no_cache_can_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])

    @compile_function()
    def twice(value: int) -> int:
        return 2 * value

    assert isinstance(twice, CPUDispatcher)
    assert twice(21) == 42


def test_a_process_announces_that_it_compiles_and_the_next_one_loads_the_result(tmp_path: Path) -> None:
    (tmp_path / "twice.py").write_text(
        "import logging\nfrom operators.compilation import compile_function\n"
        "@compile_function()\ndef twice(value): return 2 * value\n"
        "logging.basicConfig(level=logging.INFO, format='%(message)s')\n"
        "twice(21), twice(2.1)\n"
    )
    found = [
        subprocess.run(
            [sys.executable, tmp_path / "twice.py"],
            check=True,
            capture_output=True,
            text=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        ).stderr
        for _ in range(2)
    ]
    assert found[0].count("compiling for this machine") == 1
    assert found[1] == ""


def test_progress_is_logged_once_at_the_start_and_with_every_tenth_function(
    caplog: pytest.LogCaptureFixture,
) -> None:
    announcer = vars(compilation)["_Announcer"]()
    with caplog.at_level(logging.INFO, "slipflow.compilation"):
        for _ in range(25):
            announcer.on_start(None)
            announcer.on_end(None)
    first, *others = caplog.messages
    assert first.startswith("compiling for this machine: up to a minute, once")
    assert others == [f"compiling: {number} functions are ready" for number in (10, 20)]


FACTOR = 2.0


def _times(value: float) -> float:
    return FACTOR * value


def test_a_changed_constant_of_a_helper_is_compiled_again(monkeypatch: pytest.MonkeyPatch) -> None:
    found = list[float]()
    for factor in (2.0, 3.0):
        monkeypatch.setitem(globals(), "FACTOR", factor)

        @row_loop.row_loop
        def scaled(value: float) -> float:
            return _times(value)

        found.append(scaled(7.0))
    assert found == [14.0, 21.0]
