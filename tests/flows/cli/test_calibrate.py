"""The command `slipflow calibrate` as a process."""

import json
from pathlib import Path

from tests.command import slipflow


def test_a_calibrated_model_runs_live_with_its_rate(tiny: Path, tmp_path: Path) -> None:
    options = ("--on", str(tiny), "--false-alarms", "12/min", "--confidence", "90%", "--json")
    done = slipflow("calibrate", "tcn", *options, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["path"], found["confidence"]) == ("tcn.safetensors", 0.9)
    assert found["false_alarms_per_min"] == 12
    again = slipflow("calibrate", "tcn.safetensors", *options[:-1], cwd=tmp_path)
    assert "of slips missed" in again.stdout
    setting = ("--set", "detector=tcn.safetensors", "--set", "false_alarms=12/min")
    assert f"`slipflow run live {' '.join(setting)}`" in again.stdout
    assert slipflow("check", "live", cwd=tmp_path).returncode == 0
    live = slipflow("run", "live", "--for", "1s", *setting, cwd=tmp_path)
    assert live.returncode == 0, live.stderr


def test_mistakes_are_one_line_with_the_remedy(tiny: Path, tmp_path: Path) -> None:
    on = ("calibrate", "tcn", "--on", str(tiny))
    for arguments, expected in (
        ((*on, "--false-alarms", "2"), "must be a rate with its unit: 1/min or 6/h"),
        ((*on, "--false-alarms", "0/min"), "must be above 0"),
        ((*on, "--confidence", "0.95"), "must be a share with its unit: 95%"),
        ((*on, "--confidence", "50%"), "must be from 0.8 to 0.999"),
        ((*on, "-o", "nowhere/tcn.safetensors"), "folder nowhere does not exist"),
        (("run", "live", "--set", "false_alarms=1/min"), "run `slipflow calibrate tcn --on SESSIONS"),
    ):
        done = slipflow(*arguments, cwd=tmp_path)
        assert (done.returncode, done.stdout) == (2, "")
        assert expected in done.stderr.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []
