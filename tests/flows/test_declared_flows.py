"""The shipped flows, built and run over the simulated rig in virtual time."""

import asyncio
import re
from pathlib import Path

import polars as pl
import pytest

from flows.cli.demo_command import report
from flows.demo import demo
from flows.graph.loading import load
from flows.graph.validation import problems
from flows.record import record
from flows.run.replay_runner import ReplayRunner
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


def test_a_recorded_session_has_labelled_samples_and_replays_to_the_same(tmp_path: Path) -> None:
    run = execute(record(out=str(tmp_path / "live")), duration=20 * s, start=0)
    assert run.sinks["dataset"].dropped == 0
    session = Session.open(tmp_path / "live")
    asyncio.run(ReplayRunner(record(out=str(tmp_path / "again")), session, "again").execute())
    live, again = (
        pl.read_parquet(f"{tmp_path}/{which}/sessions/*/samples/*.parquet") for which in ("live", "again")
    )
    assert live.equals(again)
    assert len(live) == pytest.approx(2000, abs=20)
    assert set(live["label"].unique()) >= {0, 1}
    assert live["velocity"].arr.first().is_not_nan().mean() == pytest.approx(1, abs=0.02)


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
