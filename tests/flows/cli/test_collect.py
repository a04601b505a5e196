"""The command `slipflow collect`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from flows.graph.validation import problems
from tests.command import error, slipflow, succeed
from tests.pages import ROOT, block

SPHERE = """
speeds = ["50mm/s"]
repeats = 1
rotations = 1
rounds = 1
[path]
rest = "0.3s"
[[surfaces]]
shape = "sphere"
radius = "60mm"
pose = [0.4, 0, 0.1, 3.1415926, 0, 0]
"""


def plan(folder: Path, text: str) -> str:
    """Write a plan file and return its name."""
    (folder / "mine.toml").write_text(text)
    return "mine.toml"


def test_a_dry_run_prints_path_duration_and_bounds(tmp_path: Path) -> None:
    done = succeed("collect", plan(tmp_path, SPHERE), "--dry-run", cwd=tmp_path)
    head, strokes, rotation, whole, workspace, pressed = done.stdout.splitlines()
    assert head.split()[:3] == ["session", "strokes", "time"]
    assert strokes.split()[:2] == ["sphere-050-01", "8"]
    assert "385 .. 415" in strokes
    assert "97 .. 110" in whole  # 1.9 mm down the side, and 1.5 mm pressed
    assert pressed == "pressed 1.5 mm after first contact"
    assert rotation.startswith("sphere-rotation-01")
    assert whole.split()[:4] == ["total", "16", "1.1", "min"]
    assert "380 .. 420" in workspace
    assert "the arm's pose is unknown" in done.stderr
    assert "origin of the base frame" not in done.stderr  # the plan gives the pose
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]


def test_without_ur_rtde_nothing_starts(tmp_path: Path, hide_packages: Callable[..., None]) -> None:
    hide_packages("ur-rtde")
    line = error("collect", "tiny", "--robot", "127.0.0.1", cwd=tmp_path)
    assert line.startswith("commanding a UR arm: needs ur-rtde: in the clone, pip install -e '.[ur]'")
    assert not list(tmp_path.iterdir())


def test_a_printed_plan_is_a_plan(tmp_path: Path) -> None:
    done = slipflow("collect", "paper", "--print", cwd=tmp_path)
    again = slipflow("collect", plan(tmp_path, done.stdout), "--print", cwd=tmp_path)
    assert again.stdout == done.stdout
    assert 'speeds = ["50mm/s"' in done.stdout


def test_the_flow_on_the_hardware_page_is_valid() -> None:
    names = dict[str, Any]()
    exec(block(ROOT / "docs/how-to/hardware.md", "hold.py"), names)  # noqa: S102 - the page's own code
    assert problems(names["hold"]("10.0.0.2", "10.0.0.3")) == []
