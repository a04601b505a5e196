"""The command `slipflow rig`."""

import signal
import subprocess
from pathlib import Path

from connectors.emulators.ur_controller import PORTS
from tests.command import SLIPFLOW, slipflow


def test_the_rig_prints_its_addresses_and_ends_at_ctrl_c(tmp_path: Path) -> None:
    ports = ["--rtde", "0", "--script", "0", "--dashboard", "0", "--gripper", "0"]
    process = subprocess.Popen([*SLIPFLOW, "rig", *ports], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    assert process.stdout
    lines = [process.stdout.readline().split() for _ in range(5)]
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    assert [line[0] for line in lines] == ["takktile", "rtde", "script", "dashboard", "gripper"]
    assert "process" in lines[0]
    assert str(PORTS.rtde) not in lines[1][1]
    assert process.returncode == 130


def test_an_invalid_port_is_an_error(tmp_path: Path) -> None:
    done = slipflow("rig", "--gripper", "70000", cwd=tmp_path)
    assert done.returncode == 2
    assert "65535" in done.stderr
