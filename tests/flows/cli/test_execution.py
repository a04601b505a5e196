"""The output and the exit code of `slipflow run`."""

import re

import pytest
import typer

from flows.cli.run import report_run
from operators import Run
from operators.ports import SinkStatus
from tests.command import slipflow


def test_lost_rows_or_an_interruption_set_the_exit_code(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    run.sinks["dataset"] = SinkStatus(dropped=1)
    for error, code, text in (
        ("", 1, "dataset dropped rows (1)"),
        ("was interrupted", 130, "was interrupted"),
    ):
        run.error = error
        with pytest.raises(typer.Exit) as raised:
            report_run(run)
        assert raised.value.exit_code == code
        assert capsys.readouterr().out.splitlines()[0] == f"run1: 10.0 s; {text}"


def test_a_live_run_ends_with_its_session_and_its_counts() -> None:
    *_, session, touch, console = slipflow("run", "live", "--for", "100ms").stdout.splitlines()
    assert re.fullmatch(r"live-\d{8}T\d{6}\.\d{6}Z: 0\.\d s", session)
    assert (touch.split()[0], console.split()[0]) == ("touch:", "console:")
