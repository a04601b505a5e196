"""Rules for the code: import contracts, names, sizes, light imports, pages."""

import re
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, field
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flows.graph.testing import check_cuts
from operators import Operator, Scores
from tests.command import succeed
from tests.pages import PAGES, ROOT, block, blocks

FOLDERS = ("operators", "connectors", "storage", "flows")
TREE = (*FOLDERS, "deploy", "tests")
MODULES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))


def test_no_other_distribution_has_our_top_level_packages() -> None:
    owners = packages_distributions()
    for name in (*FOLDERS, "deploy", "tests"):
        assert set(owners.get(name, ["slipflow"])) == {"slipflow"}, name


def test_the_readme_and_the_architecture_page_are_short() -> None:
    lines = (ROOT / "README.md").read_text().splitlines()
    assert 45 <= len(lines) <= 70
    assert max(map(len, lines)) <= 100
    assert len((ROOT / "ARCHITECTURE.md").read_text().splitlines()) <= 120


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_module_named_on_a_page_exists(page: Path) -> None:
    named = re.findall(r"`([\w.-][\w./-]*\.py)`", page.read_text())  # not /etc/...
    tree = [f"/{path.relative_to(ROOT).as_posix()}" for top in TREE for path in (ROOT / top).rglob("*.py")]
    shown = re.findall(r"```python ([\w./-]+\.py)", page.read_text())  # files that the page contains
    assert [n for n in named if n not in shown and not any(path.endswith(f"/{n}") for path in tree)] == []


def test_no_module_is_longer_than_400_lines() -> None:
    assert [p.name for p in MODULES if len(p.read_text().splitlines()) > 400] == []


def test_module_names_are_unique() -> None:
    counts = Counter(path.name for path in MODULES if path.name != "__init__.py")
    assert {name for name, count in counts.items() if count > 1} == set()


def test_all_loggers_are_below_slipflow() -> None:
    foreign = {'"pymodbus.logging"', '"distributed"'}  # silenced
    names = {name for path in MODULES for name in re.findall(r"getLogger\((.*?)\)", path.read_text())}
    assert [name for name in names - foreign if not re.fullmatch(r'"slipflow(\.\w+)?"', name)] == []


@pytest.mark.parametrize(
    ("code", "light"),
    [
        ("import operators", {"numpy"}),
        ("from connectors import Console, Mqtt; Console(), Mqtt('mqtt://localhost')", {"asyncio", "numpy"}),
        ("import flows.cli.main", {"asyncio"}),
        ("from flows.cli.check import check; check('live')", {"asyncio", "numba", "numpy", "scipy"}),
    ],
)
def test_heavy_packages_are_imported_when_they_are_needed(code: str, light: set[str]) -> None:
    heavy = {"aiohttp", "aiomqtt", "asyncio", "matplotlib", "numba", "numpy", "pandas", "polars", "pyarrow"}
    heavy |= {"rich", "scipy", "torch"}
    code = f"{code}; import sys; print({heavy - light} & {{*sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"


def test_the_flow_of_the_readme_runs_and_prints_slip_events(tmp_path: Path) -> None:
    (tmp_path / "slip.py").write_text(block(ROOT / "README.md", "slip.py"))
    succeed("check", "slip.py", cwd=tmp_path)
    done = succeed("run", "slip.py", "--for", "5s", cwd=tmp_path)
    assert re.search(r"^\S+ \S+  finger 0  slip onset  p [01]\.\d\d ", done.stdout, re.MULTILINE)


def test_the_operator_on_the_architecture_page_keeps_the_invariant() -> None:
    [body] = [each.body for each in blocks(ROOT / "ARCHITECTURE.md") if each.language == "python"]
    names: dict[str, Any] = {"dataclass": dataclass, "field": field, "Operator": Operator, "Scores": Scores}
    exec(body, names)  # noqa: S102 - our own page
    scores = Scores(np.arange(9), np.linspace(0, 1, 9), finger=1)
    check_cuts(names["Smooth"](), scores)
