import subprocess
import sys

import operators
from operators import detectors
from operators.detectors import DETECTORS


def test_all_names_are_there_and_sorted_as_the_linter_sorts_them() -> None:
    for module in (operators, detectors):
        assert all(hasattr(module, name) for name in module.__all__)
        assert len(set(module.__all__)) == len(module.__all__)


def test_operators_import_with_numpy_alone() -> None:
    heavy = {"aiomqtt", "numba", "pandas", "polars", "pyarrow", "scipy", "torch"}
    code = f"import sys, operators, operators.detectors; print(sorted({heavy!r} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_detectors_that_need_no_weights_are_known_by_their_names() -> None:
    assert {name: make().name for name, make in DETECTORS.items()} == {name: name for name in DETECTORS}
