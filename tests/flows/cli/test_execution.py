import pytest
import typer

from flows.cli.run import report_run
from operators import Run
from operators.ports import SinkStatus


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
            report_run(run, as_json=False)
        assert raised.value.exit_code == code
        assert capsys.readouterr().out.splitlines()[0] == f"run1: 10.0 s; {text}"
