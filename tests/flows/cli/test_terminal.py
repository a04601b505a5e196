import json
import logging
import sys
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from connectors import Console
from flows.cli.live_view import print_json
from flows.cli.main import main
from flows.cli.terminal import Format, PipeHandler, begin_log, logged, note
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from flows.graph.validation import problems
from flows.run.live_runner import LiveRunner
from operators import Debounce, Faults, Run, Scores, Slips
from tests.command import slipflow


@pytest.fixture
def log_text(monkeypatch: pytest.MonkeyPatch) -> Iterator[StringIO]:
    """The JSON log as text."""
    root, ours, stream = logging.getLogger(), logging.getLogger("slipflow"), StringIO()
    handlers, level = root.handlers[:], ours.level
    root.handlers[:] = []
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        begin_log(Format.JSON)
    yield stream
    root.handlers[:] = handlers
    ours.setLevel(level)


def objects(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def scores(*probability: float) -> Scores:
    return Scores(np.arange(len(probability)), np.array(probability))


@pytest.mark.virtual
async def test_the_log_has_the_start_failures_and_result_of_a_run(log_text: StringIO) -> None:
    flow = Flow("pressed")
    source = TestSource(Scores, [scores(0.1), OSError("unplugged"), scores(0.2, 0.3)])
    flow.source(source, "touch").to(TestSink(failures=[OSError("disk full")]))

    runner = LiveRunner(flow, "run1")
    with logged(runner.run):
        await runner.execute()
    found = objects(log_text.getvalue())
    assert found[0]["event"] == "run_begins"
    assert found[-1]["event"] == "run_ends"
    by_event = {each["event"]: each for each in found}
    assert by_event["run_begins"]["sources"] == ["touch"]
    assert (by_event["run_begins"]["live"], by_event["run_begins"]["recording"]) == (True, None)
    assert (by_event["source_failed"]["source"], by_event["source_failed"]["reason"]) == (
        "touch",
        "unplugged",
    )
    gap = by_event["source_restarted"]["gap"]
    assert gap["reason"] == "unplugged"
    assert gap["end"] > gap["start"]
    assert by_event["sink_failed"]["reason"] == "disk full"
    assert by_event["sink_restored"] | {"time": ""} == {
        "time": "",
        "event": "sink_restored",
        "level": "warning",
        "sink": "testsink",
        "dropped": 0,
    }
    touch = by_event["run_ends"]["sources"]["touch"]
    assert (touch["rows"], touch["late"], touch["failures"], touch["error"]) == (3, 0, 1, "")
    assert touch["gaps"] == [gap]
    assert by_event["run_ends"]["sinks"]["testsink"]["rows"] == 3
    assert (by_event["run_ends"]["level"], by_event["run_ends"]["error"]) == ("warning", None)


def test_a_run_that_could_not_begin_ends_with_an_error(log_text: StringIO, run: Run) -> None:
    with pytest.raises(OSError, match="unplugged"), logged(run):
        raise OSError("unplugged")
    last = objects(log_text.getvalue())[-1]
    assert (last["event"], last["error"], last["level"]) == ("run_ends", "unplugged", "error")


def test_other_records_are_logged_without_credentials(log_text: StringIO) -> None:
    log = logging.getLogger("slipflow.other")
    log.warning("cannot reach %s", "mqtt://me:s3cret@host:1883 and http://host/?token=s3cret2&x=1")
    log.error("failed", exc_info=OSError("http://me:s3cret@host"))
    assert "s3cret" not in log_text.getvalue()
    first, second = objects(log_text.getvalue())
    assert first["message"] == "cannot reach mqtt://...@host:1883 and http://host/?token=...&x=1"
    assert (first["event"], first["level"], second["level"]) == ("log", "warning", "error")
    assert second["traceback"].endswith("OSError: http://...@host")


def test_notes_and_the_error_of_a_command_are_records_of_a_json_log(
    log_text: StringIO, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    note("metrics: http://host:9464")
    monkeypatch.setattr(sys, "argv", ["slipflow", "run", "missing.py", "--log", "json"])
    with pytest.raises(SystemExit):
        main()
    assert [(each["level"], each["message"]) for each in objects(log_text.getvalue())] == [
        ("info", "metrics: http://host:9464"),
        ("error", "missing.py: there is no such file"),
    ]
    assert capsys.readouterr().err == ""


async def test_consoles_print_json_and_one_is_added_if_there_is_none(
    capsys: pytest.CaptureFixture[str],
) -> None:
    flow = Flow("pressed")
    slips = flow.source(TestSource(Scores, [scores(0.9, 0.9)])) | Debounce()
    slips.to(Console())
    print_json(flow)

    await LiveRunner(flow, "run1").execute()
    assert [each["event"] for each in objects(capsys.readouterr().out)] == ["slip_onset"]
    bare = Flow("bare")
    slips = bare.source(TestSource(Scores)) | Debounce()
    slips.to(TestSink())
    bare.source(TestSource(Faults)).to(TestSink())
    print_json(bare)
    [console] = [node for node, sink in bare.sinks().items() if isinstance(sink, Console)]
    assert [parent.gives for parent in console.inputs] == [Slips, Faults]
    assert problems(bare) == []


def test_run_with_log_json_prints_only_objects(tmp_path: Path) -> None:
    trace = tmp_path / "trace.csv"
    rows = [
        f"{k / 100},{','.join(str(-100 - (300 * (k % 3) if k > 150 else 0)) for _ in range(6))}"
        for k in range(300)
    ]
    trace.write_text("\n".join(["t,s1,s2,s3,s4,s5,s6", *rows, ""]))
    done = slipflow(
        "run", "live", "--set", "detector=psd", "--replay", trace, "--pace", "100", "--log", "json"
    )
    assert done.returncode == 0, done.stderr
    events = [each["event"] for each in objects(done.stdout)]
    assert events[-1] == "run_ends"
    assert {"run_begins", "slip_onset"} <= {*events}


class Gone(StringIO):
    def __init__(self, error: OSError) -> None:
        super().__init__()
        self.error = error

    def write(self, _text: str) -> int:
        raise self.error


def test_a_closed_pipe_is_not_an_error_but_a_full_disk_is(capsys: pytest.CaptureFixture[str]) -> None:
    record = logging.makeLogRecord({"msg": "slip"})
    PipeHandler(Gone(BrokenPipeError())).handle(record)
    assert capsys.readouterr().err == ""
    PipeHandler(Gone(OSError("No space left on device"))).handle(record)
    assert "No space left on device" in capsys.readouterr().err
