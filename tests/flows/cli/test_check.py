"""`slipflow check` in processes of its own."""

from pathlib import Path

import pytest

from tests.command import error, slipflow, succeed
from tests.flows.cli.test_import_command import TRACE

OWN = """
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from operators import Align, Motion, Operator, Touch, Zero, Zeroed

class Own(TestSource):
    def prepare(self):
        print("prepared")

class Empty(Operator[Zeroed, Zeroed]):
    pass

flow = Flow("own")
"""


def test_check_reports_a_correct_flow_and_lists_its_parameters() -> None:
    done = succeed("check", "live")
    assert done.stdout.startswith("flow live\n")
    assert "live: OK (sources: touch; sinks: console)" in done.stdout
    assert "--set detector=tcn  (text)" in done.stdout
    assert "--set broker=None  (text or none)\n      Broker URL, such as mqtt://localhost" in done.stdout


def test_check_prepares_the_sources_as_a_run_does(tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    path.write_text(OWN + "flow.source(Own(Touch)).to(TestSink())\n")
    assert "\nprepared\nown: OK" in slipflow("check", str(path)).stdout


def test_check_finds_every_problem(tmp_path: Path) -> None:
    path = tmp_path / "wrong.py"
    path.write_text(
        OWN + "touch, motion = flow.source(TestSource(Touch)), flow.source(TestSource(Motion))\n"
        "(motion & touch | Align()).to(TestSink())\n"
    )
    done = slipflow("check", str(path))
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "error: flow 'own': motion -> Align: Align takes Zeroed, not Motion",
        "error: flow 'own': touch -> Align: Align takes Motion, not Touch",
    ]
    assert error("run", str(path)).startswith("flow 'own': motion -> Align")


@pytest.mark.parametrize(
    ("operators", "message"),
    [
        ("Zero() | Empty()", "Empty: has no process: write def process(self, batch: Scores)"),
        ("Zero((1, 2, 3))", "Zero: baseline is (1, 2, 3), must be one count, or 6, one for each cell, not 3"),
    ],
)
def test_check_prepares_the_operators_of_a_run(operators: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    path.write_text(OWN + f"(flow.source(TestSource(Touch)) | {operators}).to(TestSink())\n")
    line = slipflow("check", path).stderr.splitlines()[-1]
    assert line.startswith("error: " + message)


def test_a_folder_with_the_name_of_a_shipped_flow_does_not_hide_it(tmp_path: Path) -> None:
    (tmp_path / "record").mkdir()
    assert "record: OK" in slipflow("check", "record", cwd=tmp_path).stdout


def test_a_trace_in_a_flow_is_read_by_a_run_of_it_only(tmp_path: Path) -> None:
    (tmp_path / "grip.py").write_text(
        "from connectors import Console, Replay, Trace\nfrom flows.graph import Flow\n"
        "from operators import Debounce, Score, Touch, Zero\nfrom storage import load_detector\n"
        "flow = Flow('grip')\n"
        "touch = flow.source(Replay(Trace('grip.csv'), Touch))\n"
        "(touch | Zero() | Score(load_detector('psd')) | Debounce()).to(Console())\n"
    )
    assert "touch = Replay(grip.csv, Touch)" in slipflow("check", "grip.py", cwd=tmp_path).stdout
    (tmp_path / "other.csv").write_text(TRACE)
    succeed("run", "grip.py", "--replay", "other.csv", cwd=tmp_path)
    assert "grip.csv" in error("run", "grip.py", cwd=tmp_path)
    (tmp_path / "other.csv").rename(tmp_path / "grip.csv")
    succeed("run", "grip.py", cwd=tmp_path)
