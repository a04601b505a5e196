"""The command `slipflow collect`."""

import ast
import importlib.util
import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.command import SLIPFLOW, slipflow
from tests.loopback import own_host

HOST = own_host(4)
NEEDS_UR = pytest.mark.skipif(importlib.util.find_spec("rtde_control") is None, reason="needs the extra `ur`")
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
PAPER = 'speeds = ["50mm/s", "75mm/s", "100mm/s"]\n'


def plan(folder: Path, text: str) -> str:
    """Write a plan file and return its name."""
    (folder / "mine.toml").write_text(text)
    return "mine.toml"


def test_a_dry_run_prints_path_duration_and_bounds(tmp_path: Path) -> None:
    done = slipflow("collect", plan(tmp_path, SPHERE), "--dry-run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    head, strokes, rotation, whole, workspace, contact, pressed = done.stdout.splitlines()
    assert head.split()[:3] == ["session", "strokes", "time"]
    assert strokes.split()[:2] == ["sphere-050-01", "8"]
    assert "385 .. 415" in strokes
    assert "97 .. 110" in whole  # 1.9 mm down the side, and 1.5 mm pressed
    assert pressed == "pressed 1.5 mm after first contact"
    assert rotation.startswith("sphere-rotation-01")
    assert whole.split()[:4] == ["total", "16", "1.1", "min"]
    assert "380 .. 420" in workspace
    assert contact.split()[:4] == ["in", "contact", "0.5", "min;"]
    assert "the arm's pose is unknown" in done.stderr
    assert "origin of the base frame" not in done.stderr  # the plan gives the pose
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]


def test_a_dry_run_of_the_papers_plan_gives_the_same_as_json(tmp_path: Path) -> None:
    text = PAPER + "[[surfaces]]\n[[surfaces]]\nshape = 'cylinder_x'\npose = [0.5, 0, 0, 3.1415926, 0, 0]\n"
    found = json.loads(slipflow("collect", plan(tmp_path, text), "--dry-run", "--json", cwd=tmp_path).stdout)
    assert len(found["sessions"]) == 2 * (3 * 9 + 5)
    assert found["strokes"] == 64 * 16
    assert found["seconds"] > sum(each["seconds"] for each in found["sessions"])  # and from one to the next
    down = 0.06 - (0.06**2 - 0.03**2) ** 0.5  # m, the cylinder's side
    assert found["low"] == pytest.approx([-0.03, -0.03, -0.0015 - down], abs=1e-6)
    assert found["high"] == pytest.approx([0.53, 0.03, 0.01], abs=1e-6)


def test_a_dry_run_shows_the_workspace(tmp_path: Path) -> None:
    found = json.loads(slipflow("collect", "tiny", "--dry-run", "--virtual", "--json", cwd=tmp_path).stdout)
    assert found["workspace"][:2] == pytest.approx([-0.045, -0.045])  # 30 mm around the strokes
    assert found["workspace"][5] == pytest.approx(0.05)  # the arm starts 20 mm above it
    done = slipflow("collect", "tiny", "--dry-run", "--robot", "127.0.0.1", cwd=tmp_path)
    assert done.returncode == 2  # it asks a controller that does not exist


def test_a_printed_plan_is_a_plan(tmp_path: Path) -> None:
    done = slipflow("collect", "paper", "--print", cwd=tmp_path)
    again = slipflow("collect", plan(tmp_path, done.stdout), "--print", cwd=tmp_path)
    assert again.stdout == done.stdout
    assert 'speeds = ["50mm/s"' in done.stdout


def test_sigusr1_is_ignored_before_and_after_the_drive(tmp_path: Path) -> None:
    dry = (
        "import os, signal\nfrom flows.cli.main import app\n"
        "app(['collect', 'tiny', '--dry-run'], standalone_mode=False)\n"
        "os.kill(os.getpid(), signal.SIGUSR1)\nprint('alive')"
    )
    done = subprocess.run(
        [sys.executable, "-c", dry], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "alive"), done.stderr


def test_a_dry_run_with_a_force_shows_the_greatest_depth(tmp_path: Path) -> None:
    text = SPHERE.replace("60mm", "80mm").replace("0.4, 0, 0.1", "0, 0, 0") + "[press]\nmax_depth = '3mm'\n"
    arguments = [plan(tmp_path, text), "--dry-run", "--force", "2N"]
    done = slipflow("collect", *arguments, cwd=tmp_path)
    assert done.stdout.splitlines()[-1].startswith("pressed with 2 N, at the depth found for each stroke")
    found = json.loads(slipflow("collect", *arguments, "--json", cwd=tmp_path).stdout)
    assert (found["force"], found["depth"], found["sessions"][0]["radius"]) == (2.0, None, 0.08)
    assert found["low"][2] == pytest.approx(-0.003 - (0.08 - (0.08**2 - 0.015**2) ** 0.5), abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["grand", "--dry-run"], "one of paper, tiny, wide"),
        (["none.toml", "--dry-run"], "none.toml: cannot be read"),
        (["mine.toml", "--dry-run"], "mine.toml: press.depth is '2', must be a length with its unit"),
        (["tiny"], "--robot HOST"),
        (["tiny", "--dry-run", "--depth", "2"], "--depth is '2', must be a length with its unit: 1.5mm"),
        (["tiny", "--dry-run", "--depth", "2m"], "from 0 to 0.006 m"),
        (["tiny", "--dry-run", "--force", "2"], "--force is '2', must be a force with its unit: 2N"),
        (["tiny", "--dry-run", "--force", "0N"], "above 0 N"),
        (["tiny", "--dry-run", "--force", "2N", "--depth", "1mm"], "--depth or --force, not both"),
        (["tiny", "--dry-run", "--force", "60N"], "below the force limit, 50 N"),
        (["steep.toml", "--dry-run"], "at least 0.0212 m"),
        (["far.toml", "--dry-run"], "around the path"),
        (["both.toml", "--virtual"], "a virtual lab has one surface"),
        pytest.param(["tiny", "--robot", "127.0.0.1", "--rows", "a"], "must be row numbers", marks=NEEDS_UR),
        pytest.param(["tiny", "--robot", "127.0.0.1:x"], "rtde://", marks=NEEDS_UR),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(arguments: list[str], reason: str, tmp_path: Path) -> None:
    plan(tmp_path, "[press]\ndepth = '2'")
    (tmp_path / "steep.toml").write_text(SPHERE.replace("60mm", "10mm"))
    (tmp_path / "far.toml").write_text("[limits]\nworkspace = [0, 0, 0, 1, 1, 1]")
    (tmp_path / "both.toml").write_text("[[surfaces]]\n[[surfaces]]\npose = [1, 0, 0, 3, 0, 0]")
    done = slipflow("collect", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    line = done.stderr.splitlines()[-1]  # after progress messages
    assert line.startswith("error: ")
    assert reason in line


def test_without_ur_rtde_nothing_starts(tmp_path: Path) -> None:
    code = (
        "import sys\n"
        "from operators import extras\n"
        "extras.missing_packages = lambda extra: ['ur-rtde']\n"
        "from flows.cli.main import main; sys.argv[1:] = ['collect', 'tiny', '--virtual']; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: commanding a UR arm: needs ur-rtde: in the clone, pip install -e '.[ur]'")
    assert not list(tmp_path.iterdir())


@NEEDS_UR
def test_ctrl_c_stops_a_virtual_collection_and_commits(tmp_path: Path) -> None:
    arguments = [
        "collect",
        "tiny",
        "--virtual",
        "--robot",
        HOST,
        "--json",
    ]
    process = subprocess.Popen(
        [*SLIPFLOW, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    )
    assert process.stderr
    for line in process.stderr:
        if "plane-050-01" in line:
            break
    while not list(tmp_path.glob("recordings/sessions/*/session.json")):
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, messages = process.communicate(timeout=300)
    assert process.returncode == 130, messages
    found = json.loads(out)
    assert "interrupted" in found["error"]
    (session,) = tmp_path.glob("recordings/sessions/*/session.json")
    assert "interrupted" in json.loads(session.read_text())["error"]
    assert "interrupted; the arm has stopped where it is" in messages


@pytest.mark.skipif(importlib.util.find_spec("pymodbus") is None, reason="needs the extra `gripper`")
def test_the_flow_on_the_hardware_page_runs_on_the_virtual_lab(tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "hardware.md").read_text()
    [block] = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    here = block.replace('"127.0.0.1"', repr(HOST)).replace("gripper=5020", f"gripper=5020, host={HOST!r}")
    done = subprocess.run(
        [sys.executable, "-c", here], capture_output=True, text=True, check=False, cwd=tmp_path, timeout=300
    )
    assert done.returncode == 0, done.stderr
    rows = ast.literal_eval(done.stdout)
    assert rows["dataset"] > 0
    assert rows["gripper"] >= 1
