import json
import re
from pathlib import Path

import pytest
import typer

from connectors import Trace
from flows.cli.run import execute, report_run
from flows.cli.terminal import Format
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from operators import Run, Touch, s
from operators.ports import SinkStatus
from tests.flows.cli.test_import_command import TRACE


@pytest.fixture
def trace(tmp_path: Path) -> Trace:
    """Trace of three seconds at 100 Hz."""
    path = tmp_path / "trace.csv"
    path.write_text(TRACE)
    return Trace(path)


def flow() -> tuple[Flow, TestSink]:
    made, sink = Flow("pressed"), TestSink()
    made.source(TestSource(Touch)).to(sink)
    return made, sink


@pytest.mark.virtual
async def test_a_limit_ends_a_paced_replay_and_its_session_is_named_after_flow_and_time(trace: Trace) -> None:
    made, sink = flow()
    run = await execute(made, limit=s, recording=trace, pace=1.0)
    assert re.fullmatch(r"pressed-\d{8}T\d{6}\.\d{6}Z", run.session)
    assert 98 <= len(sink.rows(Touch, 0)) <= 101


def test_the_result_of_a_run_is_text_or_json(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    report_run(run, log=Format.TEXT, as_json=False)
    assert capsys.readouterr().out == "run1: 10.0 s\n"
    report_run(run, log=Format.TEXT, as_json=True)
    assert json.loads(capsys.readouterr().out)["session"] == "run1"
    report_run(run, log=Format.JSON, as_json=False)  # the log has it
    assert capsys.readouterr().out == ""


def test_lost_rows_and_an_interruption_set_the_exit_code(
    run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    run.sinks["dataset"] = SinkStatus(dropped=1)
    for error, code, text in (
        ("", 1, "dataset dropped rows (1)"),
        ("was interrupted", 130, "was interrupted"),
    ):
        run.error = error
        with pytest.raises(typer.Exit) as raised:
            report_run(run, log=Format.TEXT, as_json=False)
        assert raised.value.exit_code == code
        assert capsys.readouterr().out.splitlines()[0] == f"run1: 10.0 s; {text}"
