import math
import os
import subprocess
import sys
from collections.abc import Callable
from errno import ENOSPC
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import pytest
from numba.core import caching
from numba.core.errors import TypingError
from numba.core.registry import CPUDispatcher

from operators import (
    Align,
    Debounce,
    Motion,
    Sample,
    Scores,
    Touch,
    Zero,
    Zeroed,
    compilation,
    ms,
    steps,
)  # fmt: skip
from operators.batch import Reals, packed_type
from operators.column import column
from operators.compilation import compile_function, compile_program


def test_a_function_is_compiled_where_no_cache_can_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])

    @compile_function()
    def twice(value: int) -> int:
        return 2 * value

    assert isinstance(twice, CPUDispatcher)
    assert twice(21) == 42


def test_a_full_disk_prevents_no_compilation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caching.IndexDataCacheFile, "save", Mock(side_effect=OSError(ENOSPC, "full")))
    program = compile_program(_function("def run(rows):\n    return rows[0].x * 3.25"), [_ROWS], {})
    assert program(_ROWS) == 3.25


def _run(script: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "NUMBA_CACHE_DIR": str(script.parent)}
    command = [sys.executable, str(script), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True, env=env)


def test_a_process_announces_that_it_compiles_and_the_next_one_loads_the_result(tmp_path: Path) -> None:
    script = tmp_path / "twice.py"
    script.write_text(
        "import logging\nfrom operators.compilation import compile_function\n"
        "@compile_function()\ndef twice(value): return 2 * value\n"
        "logging.basicConfig(level=logging.INFO, format='%(message)s')\n"
        "twice(21), twice(2.1)\n"
    )
    found = [_run(script).stderr for _ in range(2)]
    assert found[0].count("compiling for this machine") == 1
    assert found[1] == ""


def test_compiled_code_of_other_types_and_of_a_module_since_renamed_is_not_mixed_up(tmp_path: Path) -> None:
    script, before = tmp_path / "run.py", tmp_path / "before.py"
    script.write_text(
        "import importlib, sys, numpy as np\nfrom operators.compilation import compile_program\n"
        "add = importlib.import_module(sys.argv[1]).add\n"
        "def run(rows): return add(rows[0]) + add(rows[1])\n"
        "for size in map(int, sys.argv[2:]):\n"
        "    rows = np.zeros(2, [('x', float, (size,))])\n"
        "    print(compile_program(run, [rows], {})(rows))\n"
    )
    before.write_text(
        "import math\ndef add(row):\n    total = 0.0\n    for x in row.x:\n"
        + "".join(f"        total += math.floor(x + {number})\n" for number in range(60))  # not inlined
        + "    return total\n"
    )
    assert _run(script, "before", "3").stdout.split() == ["10620.0"]
    assert _run(script, "before", "5", "3").stdout.split() == ["17700.0", "10620.0"]
    before.rename(tmp_path / "after.py")
    assert _run(script, "after", "3").stdout.split() == ["10620.0"]


def _function(text: str, **scope: object) -> FunctionType:
    defined: dict[str, Any] = scope
    exec(text, defined)  # noqa: S102 - ours
    return cast("FunctionType", defined["run"])


_ROWS = np.array([(1.0, 2.0)], [("x", float), ("y", float)])
_HELPED = "def run(rows):\n    return help(rows[0].x)"


def _helper(text: str, **scope: object) -> FunctionType:
    return _function(f"def run(x):\n    return {text}", **scope)


def _compiled(text: str, **scope: object) -> FunctionType:
    return compile_function()(_helper(text, **scope))


def _reads(text: str, **scope: object) -> FunctionType:
    return _function(f"def run(rows):\n    return {text} * rows[0].x", **scope)


def _module(**content: object) -> ModuleType:
    module = ModuleType("gains")
    vars(module).update(content)
    return module


CHANGES: dict[str, Callable[[int], FunctionType]] = {
    "constant": lambda v: _function(f"def run(rows):\n    return {v}.5"),
    "column": lambda v: _function(f"def run(rows):\n    return rows[0].{'_xy'[v]}"),
    "builtin": lambda v: _function(_HELPED, help={1: math.cos, 2: math.sin}[v]),
    "helper": lambda v: _function(_HELPED, help=_helper(f"x + {v}")),
    "number": lambda v: _reads("GAIN", GAIN=v + 1.0),
    "number in a module": lambda v: _reads("gains.GAIN", gains=_module(GAIN=v + 1.0)),
    "number in a package": lambda v: _reads("own.gains.GAIN", own=_module(gains=_module(GAIN=v + 1.0))),
    "number in a long table": lambda v: _reads("TABLE[1500]", TABLE=np.arange(3000.0) + v),
    "compiled helper in a module": lambda v: _reads("help.add(1)", help=_module(add=_compiled(f"x + {v}"))),
    "helper of a compiled helper": lambda v: _function(
        _HELPED, help=_compiled("inner(x)", inner=_compiled(f"x + {v + 2}"))
    ),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_change_of_what_a_program_reads_makes_another_one(change: Callable[[int], FunctionType]) -> None:
    """Its key is all of that: the file of a step is not that of its program, whose age numba compares."""
    before, after = change(1), change(2)
    found = [compile_program(each, [_ROWS], {})(_ROWS) for each in (before, after, before)]
    assert found == [before(_ROWS.view(np.recarray)), after(_ROWS.view(np.recarray)), found[0]]
    assert found[0] != found[1]


def test_another_parameter_needs_no_other_program() -> None:
    touch, motion, scores = Touch.zeros(), Motion.zeros(), Scores.zeros()
    programs: dict[object, object] = vars(compilation)["_programs"]
    sizes = list[int]()
    for scans, threshold, within in ((50, 0.5, 5 * ms), (100, 0.9, 20 * ms)):
        Debounce(threshold).push(scores)
        Align(within).push(Zero(scans=scans).push(touch), motion)
        sizes.append(len(programs))
    assert sizes[0] == sizes[1]


class _Warm(Zeroed):
    heat: Reals = column(np.float64)


def test_only_the_columns_of_a_common_base_are_copied() -> None:
    run = _function("def run(rows):\n    copy(rows[0].sample, rows[0].other)", copy=steps.copy)
    rows = np.ones(1, [("sample", packed_type(Sample)), ("other", packed_type(_Warm))])
    rows["other"] = 2
    compile_program(run, [rows], {})(rows)
    row = rows["sample"][0]
    assert (row["valid"].tolist(), row["velocity"].tolist(), row["matched"]) == ([2] * 6, [1.0] * 6, 1)
    rows = np.zeros(1, [("sample", packed_type(Sample)), ("other", packed_type(Motion))])
    with pytest.raises(TypingError, match=r"cannot copy: .* do not begin with the same columns"):
        compile_program(run, [rows], {})
