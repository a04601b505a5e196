import sys
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from shutil import copytree, rmtree

import pytest

from connectors import Gripper, Mqtt
from flows.graph.testing import TestSink, TestSource
from flows.graph.validation import validate
from flows.run.clocks import EventClock
from flows.run.executor import workers
from flows.run.live_runner import LiveRunner
from flows.run.replay_runner import ReplayRunner, replayed
from flows.run.replays import FlowSource, Replayed, Replays, check_outputs, open_recording, recordings
from flows.run.replays import replay as replay_task
from operators import Debounce, Score, Touch, Zero
from operators.detectors import Psd
from operators.errors import FlowError, InputError
from operators.fingertip import TAKKTILE
from storage import Session
from storage.files import put_checked, read_checked
from storage.layout import SESSION, session_folder
from tests.flows.run.live import Described, flow_of
from tests.flows.run.recorder import record
from tests.storage.made import contents, session_names

FLOW = """
from connectors import Console, Mqtt
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from operators import Debounce, Score, Slips, Touch, Zero
from storage import Dataset, load_detector

class Spoilt(TestSink):
    def take(self, batch: Slips):
        raise ValueError("no number")

def felt(out: str = "out", broker: str = "", spoilt: bool = False, least: float = 0.5) -> Flow:
    flow = Flow("felt")
    zeroed = flow.source(TestSource(Touch)) | Zero()
    slips = zeroed | Score(load_detector("psd")) | Debounce(threshold=least)
    dataset = Dataset(out)
    zeroed.to(dataset)
    slips.to(dataset)
    slips.to(Console())
    if broker:
        slips.to(Mqtt(broker, rig="rig"))
    if spoilt:
        slips.to(Spoilt())
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
        record(root, f"{seconds:02d}-seconds", seconds, (0,))
    return root


@pytest.fixture(scope="module")
def four(dataset: Path) -> list[Path]:
    return recordings([dataset])


def source(target: str, **settings: str) -> FlowSource:
    return FlowSource(target, tuple(settings.items()))


def replay(felt: str, paths: list[Path], out: Path, **settings: str) -> list[Replayed]:
    return list(Replays(source(felt, out=str(out), **settings), paths).run())


def test_two_workers_give_the_bytes_and_lines_that_one_process_gives(
    felt: str, four: list[Path], tmp_path: Path, two: Executor
) -> None:
    one = replay(felt, four, tmp_path / "1")
    more = list(Replays(source(felt, out=str(tmp_path / "2")), four).run(two))
    assert [each.error for each in (*one, *more)] == [""] * 8
    assert [each.recording for each in more] == list(map(str, four))
    assert [each.printed for each in one] == [each.printed for each in more]
    assert "slip onset" in "".join(each.printed for each in one)
    assert [each.summary for each in one] == [each.summary for each in more]
    files = contents(tmp_path / "1")
    assert files == contents(tmp_path / "2")
    parts = "touch/part-000000.parquet", "slips.parquet"
    assert {f"sessions/{path.name}/{part}" for path in four for part in parts} < {*files}
    assert sorted(path.name for path in (tmp_path / "2").iterdir()) == ["dataset.json", "sessions"]


def test_a_flow_takes_its_file_and_modules_along_and_newer_ones_replace_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path])
    code = FLOW.replace("threshold=least", "threshold=chosen.LEAST") + "import chosen\n"
    sent = list[FlowSource]()
    for least in ("0.5", "0.75"):
        place = tmp_path / least
        place.mkdir()
        (place / "felt.py").write_text(code)
        (place / "chosen.py").write_text(f"LEAST = {least}\n")
        sent.append(source(f"{place / 'felt.py'}:felt", out=str(tmp_path / "out")).with_files())
        assert [name for name, _ in sent[-1].files] == ["chosen.py", "felt.py"]
        rmtree(place)
        sys.modules.pop("chosen")
        sys.path.remove(str(place))
    received = [n.part for each in sent for n in each.flow().nodes]
    assert [each.threshold for each in received if isinstance(each, Debounce)] == [0.5, 0.75]
    assert source("relabel").with_files().files == ()


def test_a_repeated_task_changes_nothing_and_another_flow_is_refused(
    felt: str, four: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    [first] = replay(felt, four[:1], out)
    before, same = contents(out), source(felt, out=str(out))
    (out / ".partial" / four[0].name).mkdir(parents=True)  # of a worker killed at its end
    assert list(Replays(same, four[:1]).run()) == []
    assert not (out / ".partial").exists()
    again = Replays(same, four[:2])
    assert (again.existing, again.recordings) == (four[:1], four[1:2])
    assert replay_task(same, str(four[0])) == first  # as after the loss of the worker that had finished it
    assert contents(out) == before
    renamed = copytree(four[1], tmp_path / four[0].name)
    assert "another session has this name" in replay_task(same, str(renamed)).error
    assert contents(out) == before
    other = source(felt, out=str(out), least="0.6")
    with pytest.raises(InputError, match="is of another recording, flow or detector: write to another"):
        Replays(other, four[:1])


def test_a_replay_by_other_code_or_without_a_declaration_is_not_taken_for_done(
    four: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "felt.py").write_text(FLOW + "import beside\n")
    (tmp_path / "beside.py").write_text("LEAST = 0.5\n")
    flow = source(f"{tmp_path / 'felt.py'}:felt", out=str(tmp_path / "out"))
    assert [each.error for each in Replays(flow, four[:1]).run()] == [""]
    assert Replays(flow, four[:1]).existing == four[:1]
    sys.modules.pop("beside")
    (tmp_path / "beside.py").write_text("LEAST = 0.75\n")
    FlowSource.flow.cache_clear()
    with pytest.raises(InputError, match="is of another recording, flow or detector"):
        Replays(flow, four[:1])
    path = session_folder(tmp_path / "out", four[0].name) / SESSION
    put_checked(path, {key: each for key, each in read_checked(path).items() if key != "declaration"})
    with pytest.raises(InputError, match="is of another recording, flow or detector"):
        Replays(flow, four[:1])
    sys.modules.pop("beside")


def test_recordings_of_one_name_need_two_datasets(felt: str, four: list[Path], tmp_path: Path) -> None:
    others = [copytree(path, tmp_path / path.name) for path in four[1::-1]]
    with pytest.raises(InputError) as raised:
        Replays(source(felt, out=str(tmp_path / "out")), [*four[:2], *others])
    expected = f"{others[0]}: has the same name as {four[1]}: replay it into another dataset"
    assert str(raised.value) == expected


def test_a_failed_sink_ends_its_replay_without_session(felt: str, four: list[Path], tmp_path: Path) -> None:
    found = replay(felt, four[:2], tmp_path / "out", spoilt="true")
    assert [each.error for each in found] == ["ValueError: no number"] * 2
    assert session_names(tmp_path / "out") == []
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["dataset.json", "sessions"]


def test_a_sink_that_is_not_shared_needs_one_process(felt: str, four: list[Path], tmp_path: Path) -> None:
    replays = Replays(source(felt, out=str(tmp_path), spoilt="true"), four)
    [name] = replays.exclusive_sinks
    with (
        workers(2) as executor,
        pytest.raises(FlowError, match=f"{name}: cannot be shared by processes: replay"),
    ):
        list(replays.run(executor))


def test_a_flow_with_a_sink_for_live_runs_is_refused(felt: str, four: list[Path], tmp_path: Path) -> None:
    publishing, recording = source(felt, out=str(tmp_path), broker="mqtt://localhost"), Session.open(four[0])
    ways: list[Callable[[], object]] = [
        lambda: Replays(publishing, four),
        lambda: ReplayRunner(publishing.flow(), recording, "again"),
        lambda: LiveRunner(replayed(publishing.flow(), recording), "again", clock=EventClock(0)),
    ]
    for way in ways:
        with pytest.raises(FlowError, match=r"^flow 'felt': mqtt: is for live runs: remove it to replay"):
            way()
    assert Mqtt.live_only
    assert Gripper.live_only


def test_a_dataset_names_its_sessions_in_order_and_repeated_ones_once(dataset: Path, tmp_path: Path) -> None:
    trace, gone = tmp_path / "trace.csv", tmp_path / "gone"
    found = recordings([trace, dataset, gone, *dataset.glob("sessions/1*"), trace])
    assert found == [trace, *(session_folder(dataset, name) for name in session_names(dataset)), gone]
    (tmp_path / "empty/sessions").mkdir(parents=True)
    with pytest.raises(InputError, match="empty: has no session"):
        recordings([tmp_path / "empty"])


@pytest.mark.parametrize("name", ["PAD.CSV", "pad.dat", "pad"])
def test_a_file_is_opened_by_its_content_under_any_name(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("t,p0,p1\n0,500,501\n0.01,502,503\n")
    assert open_recording(tmp_path / name, print).fingers(Touch) == (0,)
    (tmp_path / name).write_bytes(b"PK\3\4")
    with pytest.raises(InputError, match="is an Excel file or an archive: save it"):
        open_recording(tmp_path / name, print)


def test_a_replay_needs_a_detector_for_its_recording_not_for_the_live_source(four: list[Path]) -> None:
    fast = Described(replace(TAKKTILE, rate=200.0), (0,))
    flow = flow_of(fast, TestSink(), through=[Zero(), Score(Psd())])
    check_outputs(flow, four[:1])
    assert ReplayRunner(flow, Session.open(four[0]), "again").compiled.entries
    with pytest.raises(FlowError, match="psd needs 100 Hz; the data has 200 Hz"):
        validate(flow)
    flow.source(TestSource(Touch, fingers=(1,)))
    with pytest.raises(FlowError, match="is unconnected"):
        check_outputs(flow, four)
