"""The command `slipflow collect`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from flows.graph.validation import problems
from flows.lift import SETTLE
from operators import Grip
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
    assert done.stdout.splitlines() == [
        "16 strokes in 2 sessions, 1.1 min",
        "path: x 385 to 415 mm, y -15 to 15 mm, z 97 to 120 mm",  # 1.9 mm down the side, 1.5 mm pressed
        "workspace: x 380 to 420 mm, y -20 to 20 mm, z 92 to 125 mm",
        "pressed 1.5 mm after first contact",
    ]
    assert "the arm's pose is unknown" in done.stderr
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
    flow = names["hold"]("10.0.0.2", "10.0.0.3")
    assert problems(flow) == []
    assert [node.part.settle for node in flow.nodes if isinstance(node.part, Grip)] == [SETTLE]
