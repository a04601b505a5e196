"""The project's own habits: contracts, names, sizes, pages."""

import importlib
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass, field
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from operators import Operator, Scores, concat

ROOT = Path(__file__).parents[1]
FOLDERS = ("operators", "connectors", "storage", "flows")
MODULES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))


def test_no_other_distribution_owns_our_top_level_names() -> None:
    owners = packages_distributions()
    for name in (*FOLDERS, "deploy", "tests"):
        assert set(owners.get(name, ["slipflow"])) == {"slipflow"}, name


def test_the_architecture_page_says_what_the_import_contracts_say() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    page = (ROOT / "ARCHITECTURE.md").read_text()
    for contract in project["tool"]["importlinter"]["contracts"]:
        assert f"\n{contract['name']}.\n" in page


def test_the_readme_and_the_architecture_page_are_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) < 100
    assert len((ROOT / "ARCHITECTURE.md").read_text().splitlines()) <= 120


def test_no_module_is_longer_than_400_lines() -> None:
    assert [p.name for p in MODULES if len(p.read_text().splitlines()) > 400] == []


@pytest.mark.parametrize("path", [p for p in MODULES if p.name == "__init__.py"], ids=str)
def test_a_folder_says_what_it_is_in_a_sentence_and_sorts_its_exports(path: Path) -> None:
    module = importlib.import_module(".".join(path.parent.relative_to(ROOT).parts))
    assert module.__doc__ is not None
    assert re.fullmatch(r"[A-Z][^\n]*\.", module.__doc__)
    exports = list(getattr(module, "__all__", ()))
    assert exports == sorted(exports, key=lambda name: (not name.isupper(), not name[0].isupper(), name))
    assert all(hasattr(module, name) for name in exports)


def test_operators_import_without_anything_heavy() -> None:
    heavy = ("scipy", "pandas", "polars", "pyarrow", "torch", "aiomqtt", "numba", "asyncio")
    code = f"import operators, sys; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_help_imports_nothing_heavy() -> None:
    heavy = ("numpy", "scipy", "polars", "pyarrow", "torch", "aiomqtt", "numba")
    code = f"import flows.commands.main, sys; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_code_blocks_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert blocks
    for block in blocks:
        done = subprocess.run([sys.executable, "-c", block], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "slips" in done.stdout


def test_the_operator_on_the_architecture_page_keeps_the_law() -> None:
    [block] = re.findall(r"```python\n(.*?)```", (ROOT / "ARCHITECTURE.md").read_text(), re.DOTALL)
    names: dict[str, Any] = {"dataclass": dataclass, "field": field, "Operator": Operator, "Scores": Scores}
    exec(block, names)  # noqa: S102 - ours
    scores = Scores(np.arange(9), np.linspace(0, 1, 9), finger=1)
    whole = names["Smooth"]()
    cut = names["Smooth"]()
    pieces = [cut.push(scores[:4]), cut.push(scores[4:])]
    assert concat(Scores, pieces).probability.tolist() == whole.push(scores).probability.tolist()
