"""The command `slipflow rig`."""

import os
import signal
import subprocess
from pathlib import Path

from connectors.emulators.ur_controller import PORTS
from tests.command import SLIPFLOW, slipflow


def test_the_rig_prints_its_addresses_and_ends_at_ctrl_c(tmp_path: Path) -> None:
    address = f"127.{os.getpid() >> 8 & 255}.{os.getpid() & 255}.1"  # of this test only
    options = ["--listen", address, "--gripper", "0"]
    process = subprocess.Popen([*SLIPFLOW, "rig", *options], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    assert process.stdout
    lines = [process.stdout.readline().split() for _ in range(5)]
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=120)
    assert [line[0] for line in lines] == ["takktile", "rtde", "script", "dashboard", "gripper"]
    assert "process" in lines[0]
    assert lines[1][1] == f"{address}:{PORTS.rtde}"
    assert process.returncode == 130


def test_an_invalid_port_is_an_error(tmp_path: Path) -> None:
    done = slipflow("rig", "--gripper", "70000", cwd=tmp_path)
    assert done.returncode == 2
    assert "65535" in done.stderr
