"""The shipped flows, built and run over the simulated rig in virtual time."""

import re
from pathlib import Path

import pytest

from flows.cli.demo_command import report
from flows.demo import demo
from flows.graph.loading import load
from flows.graph.validation import problems
from operators import Motion, Source, Touch, s
from storage import Dataset, Session
from tests.flows.run.live import execute


@pytest.mark.parametrize("name", ["demo", "lift", "live", "record", "relabel"])
def test_a_ready_made_flow_is_valid(name: str) -> None:
    assert problems(load(name).flow()) == []


@pytest.mark.parametrize("name", ["demo", "record"])
def test_a_flow_that_records_samples_records_the_raw_streams_as_they_arrive(name: str) -> None:
    [dataset] = [node for node in load(name).flow().nodes if isinstance(node.part, Dataset)]
    assert {Touch, Motion} <= {parent.gives for parent in dataset.inputs if isinstance(parent.part, Source)}


def test_the_report_of_the_demo_compares_onsets_with_the_truth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = execute(demo(str(tmp_path)), duration=20 * s, start=0)
    onsets = capsys.readouterr().out.count("slip onset")
    text = "\n".join(report(tmp_path / "sessions" / run.session))
    slips, caught, missed = map(int, re.findall(r"(\d+) true slips: (\d+) detected, (\d+) missed", text)[0])
    assert slips == caught + missed > 3
    assert caught > 0
    assert f"{onsets} onsets reported" in text
    assert "onset delay: median" in text
    assert f"{tmp_path}/sessions/test/samples/*.parquet" in text
    assert set(Session.open(tmp_path).tables) == {"touch", "motion", "samples", "slips", "episodes", "truth"}
