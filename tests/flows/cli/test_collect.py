"""`slipflow collect` as a user meets it."""

import ast
import importlib.util
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.command import SLIPFLOW, slipflow

HOST = f"127.0.{os.getpid() % 250 + 1}.4"  # of this process: ur-rtde knows one port only
SPHERE = "sphere@0.4,0,0.1,3.1415926,0,0"


def test_a_dry_run_prints_the_path_its_duration_and_its_bounds(tmp_path: Path) -> None:
    done = slipflow("collect", "tiny", "--dry-run", "--surface", SPHERE, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    head, strokes, rotation, whole, workspace, contact, pressed = done.stdout.splitlines()
    assert head.split()[:3] == ["session", "strokes", "time"]
    assert strokes.split()[:2] == ["sphere-050-01", "8"]
    assert "385 .. 415" in strokes
    assert "97 .. 110" in whole  # 1.9 mm down the side, and 1.5 mm pressed
    assert pressed == "pressed by 1.5 mm beyond the first touch"
    assert rotation.startswith("sphere-rotation-01")
    assert whole.split()[:5] == ["in", "all", "16", "1.1", "min"]
    assert "380 .. 420" in workspace
    assert contact.split()[:4] == ["in", "contact", "0.5", "min:"]
    assert "where the arm is now is unknown" in done.stderr
    assert "laid around the origin" not in done.stderr  # its place was given
    assert not list(tmp_path.iterdir())


def test_a_dry_run_of_the_papers_plan_tells_a_program_the_same(tmp_path: Path) -> None:
    arguments = ["--dry-run", "--json", "--surface", "plane", "--surface", "cylinder_x@0.5,0,0,3.1415926,0,0"]
    found = json.loads(slipflow("collect", "paper", *arguments, cwd=tmp_path).stdout)
    assert len(found["sessions"]) == 2 * (3 * 9 + 5)
    assert found["strokes"] == 64 * 16
    assert found["seconds"] > sum(each["seconds"] for each in found["sessions"])  # and from one to the next
    down = 0.06 - (0.06**2 - 0.03**2) ** 0.5  # m, the cylinder's side
    assert found["low"] == pytest.approx([-0.03, -0.03, -0.0015 - down], abs=1e-6)
    assert found["high"] == pytest.approx([0.53, 0.03, 0.01], abs=1e-6)


def test_a_dry_run_shows_the_room_that_the_arm_would_have(tmp_path: Path) -> None:
    found = json.loads(slipflow("collect", "tiny", "--dry-run", "--virtual", "--json", cwd=tmp_path).stdout)
    assert found["workspace"][:2] == pytest.approx([-0.045, -0.045])  # 30 mm around the strokes
    assert found["workspace"][5] == pytest.approx(0.05)  # the arm is 20 mm above it at first
    done = slipflow("collect", "tiny", "--dry-run", "--robot", "127.0.0.1", cwd=tmp_path)
    assert done.returncode == 2  # it asks, and nobody is there


def test_signals_to_pause_are_ignored_before_and_after_the_drive(tmp_path: Path) -> None:
    dry = (
        "import os, signal\nfrom flows.cli.main import app\n"
        "app(['collect', 'tiny', '--dry-run'], standalone_mode=False)\n"
        "os.kill(os.getpid(), signal.SIGUSR1)\nprint('alive')"
    )
    done = subprocess.run(
        [sys.executable, "-c", dry], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "alive"), done.stderr


def test_a_dry_run_with_a_force_says_how_deep_it_may_go(tmp_path: Path) -> None:
    arguments = ["--dry-run", "--surface", "sphere:0.08", "--force", "2N", "--deepest", "3mm"]
    done = slipflow("collect", "tiny", *arguments, cwd=tmp_path)
    assert done.stdout.splitlines()[-1].startswith("pressed with 2 N, each stroke at the depth where it")
    found = json.loads(slipflow("collect", "tiny", *arguments, "--json", cwd=tmp_path).stdout)
    assert (found["force"], found["depth"], found["sessions"][0]["radius"]) == (2.0, None, 0.08)
    assert found["low"][2] == pytest.approx(-0.003 - (0.08 - (0.08**2 - 0.015**2) ** 0.5), abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["grand", "--dry-run"], "one of paper, tiny"),
        (["tiny"], "--robot HOST"),
        (["tiny", "--dry-run", "--surface", "cube"], "one of plane, sphere"),
        (["tiny", "--dry-run", "--surface", "plane@1,2,3"], "must be 6 numbers"),
        (["tiny", "--dry-run", "--surface", "sphere:big"], "must be a length with its unit: 1.5mm"),
        (["tiny", "--dry-run", "--surface", "sphere:-0.06"], "must be a length with its unit: 1.5mm"),
        (["tiny", "--dry-run", "--surface", "sphere:50"], "from 0.001 to 1.0 m"),
        (["tiny", "--dry-run", "--surface", "plane:0.05"], "without a radius for a plane"),
        (["tiny", "--dry-run", "--surface", "plane", "--surface", "sphere"], "one surface: give each its @X"),
        (["tiny", "--virtual", "--surface", "plane", "--surface", SPHERE], "a virtual lab has one surface"),
        (["tiny", "--dry-run", "--depth", "2"], "--depth is '2', must be a length with its unit: 1.5mm"),
        (["tiny", "--dry-run", "--depth", "2m"], "at most 6 mm"),
        (["tiny", "--dry-run", "--force", "2N", "--deepest", "2km"], "must be a length with its unit: 1.5mm"),
        (["tiny", "--dry-run", "--force", "2N", "--deepest", "20mm"], "at most 6 mm"),
        (["tiny", "--virtual", "--watchdog", "0"], "0.1"),
        (["tiny", "--virtual", "--patience", "2"], "must be a time with its unit: 500ms"),
        (["tiny", "--virtual", "--patience", "20ms"], "must be 50ms or more"),
        (["tiny", "--dry-run", "--speeds", "fast"], "--speeds is 'fast', must be a speed with its unit"),
        (["tiny", "--dry-run", "--surface", "sphere:0.01"], "0.0212 m or more"),
        (["tiny", "--dry-run", "--speeds", "0.5m/s"], "below 0.3 m/s"),
        (["tiny", "--dry-run", "--force", "2"], "--force is '2', must be a force with its unit: 2N"),
        (["tiny", "--dry-run", "--force", "0N"], "above 0 N"),
        (["tiny", "--dry-run", "--force", "2N", "--depth", "1mm"], "--depth or --force, not both"),
        (["tiny", "--dry-run", "--force", "60N"], "below the --force-limit, 50N"),
        (["tiny", "--dry-run", "--deepest", "5mm"], "--deepest is for --force"),
        (["tiny", "--dry-run", "--workspace", "0,0,0,1,1,1"], "around the path"),
        (["tiny", "--robot", "127.0.0.1:x"], "rtde://"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(arguments: list[str], why: str, tmp_path: Path) -> None:
    done = slipflow("collect", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    line = done.stderr.splitlines()[-1]  # before it may stand what is being done
    assert line.startswith("error: ")
    assert why in line


@pytest.mark.skipif(importlib.util.find_spec("rtde_control") is None, reason="needs the extra `ur`")
def test_ctrl_c_on_a_virtual_collection_stops_and_commits(tmp_path: Path) -> None:
    arguments = [
        "collect",
        "tiny",
        "--virtual",
        "--robot",
        HOST,
        "--watchdog",
        "1",
        "--patience",
        "1s",
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
    process.send_signal(signal.SIGINT)
    out, told = process.communicate(timeout=60)
    assert process.returncode == 130, told
    found = json.loads(out)
    assert "interrupted" in found["error"]
    (session,) = tmp_path.glob("recordings/sessions/*/session.json")
    assert "interrupted" in json.loads(session.read_text())["error"]
    assert "interrupted; the arm stands where it is" in told


@pytest.mark.skipif(importlib.util.find_spec("pymodbus") is None, reason="needs the extra `gripper`")
def test_the_flow_of_the_hardware_page_runs_on_the_virtual_lab(tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "hardware.md").read_text()
    [block] = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    here = block.replace('"127.0.0.1"', repr(HOST)).replace("gripper=5020", f"gripper=5020, host={HOST!r}")
    done = subprocess.run(
        [sys.executable, "-c", here], capture_output=True, text=True, check=False, cwd=tmp_path, timeout=120
    )
    assert done.returncode == 0, done.stderr
    rows = ast.literal_eval(done.stdout)
    assert rows["dataset"] > 0
    assert rows["gripper"] >= 1
