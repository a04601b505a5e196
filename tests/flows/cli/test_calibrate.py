"""The command `slipflow calibrate` as a process."""

from pathlib import Path

from tests.command import slipflow, succeed


def test_a_calibrated_model_runs_live_with_its_rate(tiny: Path, tmp_path: Path) -> None:
    options = ("--on", str(tiny), "--false-alarms", "12/min", "--confidence", "90%")
    done = succeed("calibrate", "tcn", *options, cwd=tmp_path)
    assert "wrote tcn.safetensors and its card" in done.stdout
    again = slipflow("calibrate", "tcn.safetensors", *options, cwd=tmp_path)
    assert "of slips missed" in again.stdout
    setting = ("--set", "detector=tcn.safetensors", "--set", "false_alarms=12/min")
    assert f"`slipflow run live {' '.join(setting)}`" in again.stdout
    succeed("check", "live", cwd=tmp_path)
    succeed("run", "live", "--for", "1s", *setting, cwd=tmp_path)
