"""`slipflow rig` as a user meets it."""

import signal
import subprocess
from pathlib import Path

from connectors.emulators.ur_controller import PORTS
from tests.command import SLIPFLOW, slipflow


def test_the_rig_says_where_things_are_and_ends_at_ctrl_c(tmp_path: Path) -> None:
    ports = ["--rtde", "0", "--script", "0", "--dashboard", "0", "--gripper", "0"]
    process = subprocess.Popen([*SLIPFLOW, "rig", *ports], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    assert process.stdout
    told = [process.stdout.readline().split() for _ in range(5)]
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    assert [line[0] for line in told] == ["takktile", "rtde", "script", "dashboard", "gripper"]
    assert "process" in told[0]
    assert str(PORTS.rtde) not in told[1][1]
    assert process.returncode == 130


def test_a_port_that_cannot_be_is_one_line(tmp_path: Path) -> None:
    done = slipflow("rig", "--gripper", "70000", cwd=tmp_path)
    assert done.returncode == 2
    assert "65535" in done.stderr
