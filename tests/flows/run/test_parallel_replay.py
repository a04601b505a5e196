import json
from dataclasses import replace
from itertools import count
from pathlib import Path
from shutil import copytree
from typing import Any

import pytest

from connectors import Event
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from flows.run.parallel_replay import Replayed, Replays, check_outputs, recordings
from flows.run.replay_runner import ReplayRunner
from operators import Score, Touch, Zero
from operators.detectors import Psd
from operators.errors import FlowError, InputError, ParameterError
from operators.fingertip import TAKKTILE, Fingertip
from storage import Session
from storage.layout import session_folder, session_names
from storage.parts import read_part
from tests.connectors.mqtt.broker_process import TestBroker
from tests.flows.run.recorder import Recorder

FLOW = """
from connectors import Console, Mqtt
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from operators import Debounce, Score, Touch, Zero
from storage import Dataset, load_detector

def felt(out: str = "out", broker: str = "", spoilt: bool = False) -> Flow:
    flow = Flow("felt")
    zeroed = flow.source(TestSource(Touch)) | Zero()
    slips = zeroed | Score(load_detector("psd")) | Debounce(threshold=0.5)
    dataset = Dataset(out)
    zeroed.to(dataset)
    slips.to(dataset)
    slips.to(Console())
    if broker:
        slips.to(Mqtt(broker))
    if spoilt:
        slips.to(TestSink(failures=[ValueError("no number")] * 2))
    return flow
"""


@pytest.fixture(scope="module")
def felt(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("flow") / "felt.py"
    path.write_text(FLOW)
    return str(path)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of four sessions."""
    root = tmp_path_factory.mktemp("dataset")
    for seconds in (5, 12, 6, 11):
        recorder = Recorder(root, f"{seconds:02d}-seconds")
        recorder.record(seconds, (0,))
        recorder.close()
    return root


@pytest.fixture(scope="module")
def four(dataset: Path) -> list[Path]:
    return recordings([dataset])


def replay(felt: str, paths: list[Path], out: Path, jobs: int | None, **settings: str) -> list[Replayed]:
    return list(Replays(felt, {"out": str(out), **settings}, paths, "again").run(jobs))


def test_each_file_of_a_short_session_is_read_once(
    felt: str, four: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = [path for path in four if path.name in {"05-seconds", "06-seconds"}]
    stated = [Session.open(path).about["fingertips"] for path in short]
    assert stated == [{}, {}]  # so they are measured
    opened = list[Path]()

    def counted(path: Path, *args: Any) -> Any:  # noqa: ANN401 - as `read_part`
        opened.append(path)
        return read_part(path, *args)

    monkeypatch.setattr("storage.session.read_part", counted)
    assert [each.error for each in replay(felt, short, tmp_path / "out", 1)] == ["", ""]
    assert opened == [path / "touch/part-000000.parquet" for path in short]


def written(out: Path) -> list[tuple[str, dict[str, bytes]]]:
    """The Parquet files of each session."""
    return [
        (
            name,
            {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*.parquet"))},
        )
        for name in session_names(out)
        for folder in [session_folder(out, name)]
    ]


def test_two_processes_give_the_bytes_and_lines_that_one_gives(
    felt: str, four: list[Path], tmp_path: Path
) -> None:
    one, two = (replay(felt, four, tmp_path / str(jobs), jobs) for jobs in (1, 2))
    assert [each.error for each in (*one, *two)] == [""] * 8
    assert [each.recording for each in two] == list(map(str, four))
    assert [each.printed for each in one] == [each.printed for each in two]
    assert "slip onset" in "".join(each.printed for each in one)
    assert [each.summary for each in one] == [each.summary for each in two]
    files = written(tmp_path / "1")
    assert files == written(tmp_path / "2")
    assert [name for name, _ in files] == [f"again-{number}" for number in (1, 2, 3, 4)]
    assert all("touch/part-000000.parquet" in parts and "slips.parquet" in parts for _, parts in files)


def test_a_process_builds_the_flow_once(four: list[Path], tmp_path: Path) -> None:
    note = f"\nwith open({str(tmp_path / 'builds')!r}, 'a') as file:\n    print('built', file=file)\n"
    (tmp_path / "noted.py").write_text(FLOW + note)
    built = list[int]()
    for jobs in (1, 2):
        found = replay(f"{tmp_path / 'noted.py'}:felt", four, tmp_path / "out" / str(jobs), jobs)
        assert [each.error for each in found] == [""] * 4
        built.append(len((tmp_path / "builds").read_text().split()) - sum(built))
    assert built == [1, 3]  # the first process checks the flow


def test_a_damaged_session_is_reported_and_the_others_go_on(felt: str, dataset: Path, tmp_path: Path) -> None:
    paths = recordings([copytree(dataset, tmp_path / "dataset")])[:3]
    part = paths[1] / "touch/part-000000.parquet"
    part.write_bytes(part.read_bytes()[:-1] + b"x")
    found = replay(felt, paths, tmp_path / "out", 2)
    assert "part-000000.parquet: is damaged" in found[1].error
    assert found[1].summary is None
    assert [each.error for each in found[::2]] == ["", ""]
    assert session_names(tmp_path / "out") == ["again-1", "again-3"]


def test_an_error_of_a_sink_ends_its_own_session_only(felt: str, four: list[Path], tmp_path: Path) -> None:
    found = replay(felt, four[:2], tmp_path / "out", None, spoilt="true")
    assert [each.error for each in found] == ["ValueError: no number"] * 2
    folders = [session_folder(tmp_path / "out", name) for name in session_names(tmp_path / "out")]
    assert [Session.open(folder).about["complete"] for folder in folders] == [False, False]


def test_a_sink_that_publishes_as_one_rig_needs_one_process(
    felt: str, four: list[Path], tmp_path: Path
) -> None:
    settings = {"out": str(tmp_path), "broker": "mqtt://localhost"}
    replays = Replays(felt, settings, four, "again")
    assert replays.exclusive_sinks == ["mqtt"]
    with pytest.raises(ParameterError, match="jobs is 2, must be 1: mqtt cannot be shared by processes"):
        list(replays.run(2))


@pytest.mark.broker
def test_recordings_are_published_in_order_as_one_rig_and_the_destination_is_logged_once(
    felt: str, four: list[Path], tmp_path: Path, broker: TestBroker, caplog: pytest.LogCaptureFixture
) -> None:
    listener = broker.listen("slip/v1/lab/+/0/event")
    found = replay(felt, four[:2], tmp_path / "out", None, broker=broker.url)
    assert [each.error for each in found] == ["", ""]
    assert caplog.messages == [f"mqtt: the replay is written to {broker.url}/slip/v1/lab/rig-replay"]
    events = [Event.decode(received.payload.encode()) for received in listener.rest()]
    assert {each.rig for each in events} == {"rig-replay"}
    assert [each.seq for each in events] == list(range(1, len(events) + 1))
    assert [each.session for each in events] == sorted(each.session or "" for each in events)
    assert {each.session for each in events} == {"again-1", "again-2"}


def test_zero_jobs_are_refused(felt: str, four: list[Path]) -> None:
    with pytest.raises(ParameterError, match="jobs is 0, must be at least 1"):
        list(Replays(felt, {}, four, "again").run(0))


def test_a_flow_that_cannot_be_built_is_reported_before_any_replay(felt: str, four: list[Path]) -> None:
    with pytest.raises(InputError, match=r"^felt: has no parameter 'speed'; it has out, broker, spoilt$"):
        list(Replays(felt, {"speed": "1"}, four, "again").run(2))


def test_stopped_replays_are_committed_as_incomplete(felt: str, four: list[Path], tmp_path: Path) -> None:
    calls = count()
    replays = Replays(felt, {"out": str(tmp_path / "out")}, four, "again")
    found = list(replays.run(1, stopped=lambda: next(calls) > 0))  # after the first slice
    assert [each.error for each in found] == ["was interrupted", *["was not started: interrupted"] * 3]
    assert found[0].summary
    assert found[0].summary.rows_in > 0
    [name] = session_names(tmp_path / "out")
    folder = session_folder(tmp_path / "out", name)
    about = json.loads((folder / "session.json").read_text())
    assert (about["complete"], about["error"]) == (False, "was interrupted")
    assert len(Session.open(folder).frame("touch")) > 0


def test_a_dataset_names_its_sessions_in_order(dataset: Path, tmp_path: Path) -> None:
    trace, gone = tmp_path / "trace.csv", tmp_path / "gone"
    found = recordings([trace, dataset, gone])
    assert found == [trace, *(session_folder(dataset, name) for name in session_names(dataset)), gone]
    (tmp_path / "empty/sessions").mkdir(parents=True)
    with pytest.raises(InputError, match="empty: has no session"):
        recordings([tmp_path / "empty"])


def test_a_flow_wired_wrongly_is_each_recordings_error(tmp_path: Path, four: list[Path]) -> None:
    (tmp_path / "wrong.py").write_text("from flows.graph import Flow\nflow = Flow('wrong')\n")
    found = list(Replays(str(tmp_path / "wrong.py"), {}, four[:2], "again").run(1))
    assert [each.error for each in found] == [
        str(FlowError("wrong", "no source", "add one with flow.source(...)"))
    ] * 2


def test_a_replay_needs_a_detector_for_its_recording_not_for_the_live_source(four: list[Path]) -> None:
    class Faster(TestSource[Touch]):
        @property
        def fingertip(self) -> Fingertip:
            return replace(TAKKTILE, rate=200.0)

    flow = Flow("faster")
    (flow.source(Faster(Touch, fingers=(0,))) | Zero() | Score(Psd())).to(TestSink())
    check_outputs(flow, four[:1])
    assert ReplayRunner(flow, Session.open(four[0]), "again").compiled.entries
    with pytest.raises(FlowError, match="psd needs 100 Hz; the data has 200 Hz"):
        check_outputs(flow, [])
    flow.source(TestSource(Touch, fingers=(1,)))
    with pytest.raises(FlowError, match="is unconnected"):
        check_outputs(flow, four)
