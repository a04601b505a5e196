import asyncio
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Coroutine, Generator, Iterable
from contextlib import contextmanager
from pathlib import Path
from shutil import copytree
from typing import Any, cast

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.batch import (
    Batch,
    Episodes,
    Faults,
    Labelled,
    Motion,
    Sample,
    Scores,
    Slips,
    Touch,
    Zeroed,
    columns,
    concat,
    ms,
    s,
)
from operators.errors import BatchError, EndpointError, InputError, ParameterError, SlipflowError
from operators.ports import ClockStep, Gap, Json, SinkStatus, SourceStatus
from storage import Dataset, Session, files, verify
from storage.description import describe_dataset, read_dataset
from tests.storage.disk_steps import each_kind, observed, steps_of
from tests.storage.made import (
    STREAMS,
    contents,
    new_batch,
    new_run,
    rows,
    run_sink,
    session_names,
    side_by_side,
)
from tests.waiting import until


@contextmanager
def held(step: str) -> Generator[tuple[threading.Event, threading.Event]]:
    """Hold up a step on the disk; yield events that it was reached, and that it may go on."""
    reached, go_on = threading.Event(), threading.Event()

    def wait(name: str) -> None:
        if name == step:
            reached.set()
            assert go_on.wait(60)

    with observed(wait):
        yield reached, go_on


@settings(deadline=None, max_examples=25)
@given(
    cuts=st.lists(st.integers(0, 30), max_size=12), bounds=st.tuples(st.integers(1, 500), st.integers(1, 50))
)
def test_however_a_stream_is_cut_it_comes_back_bit_for_bit_in_bounded_parts(
    tmp_path_factory: pytest.TempPathFactory, cuts: list[int], bounds: tuple[int, int]
) -> None:
    span, most = bounds[0] * ms, bounds[1]
    root, whole = tmp_path_factory.mktemp("data"), new_batch(Touch, sum(cuts))
    pieces = [whole[sum(cuts[:n]) : sum(cuts[: n + 1])] for n in range(len(cuts))]
    dataset = Dataset(root)
    dataset.part_span, dataset.part_rows = span, most
    run_sink(dataset, new_run(live=False), pieces)
    found = concat(Touch, list(Session.open(root).read(Touch, 0, rows=7)))
    assert [getattr(found, name).tobytes() for name in ("time", "counts", "temperature", "valid")] == [
        getattr(whole, name).tobytes() for name in ("time", "counts", "temperature", "valid")
    ]
    longest = max(cuts, default=0)
    for path in root.glob("sessions/one/touch/*.parquet"):
        times = pl.read_parquet(path)["time"]
        assert len(times) <= most
        assert times[-1] - times[0] < max(span, longest * 10 * ms)


def test_every_batch_goes_to_the_table_of_its_type_also_on_a_whole_disk(tmp_path: Path) -> None:
    (tmp_path / "lost+found").mkdir()
    kinds, run = [Touch, Motion, Labelled, Slips], new_run()
    run.sink_types = {str(tmp_path): dict.fromkeys([*kinds, Episodes], (0,)), "elsewhere": {Faults: (0,)}}
    run_sink(Dataset(tmp_path), run, [new_batch(kind) for kind in kinds])
    session = Session.open(tmp_path)
    assert session.tables == ("touch", "motion", "samples", "slips", "episodes")
    assert [session.fingers(kind) for kind in kinds] == [(0,), (-1,), (0,), (0,)]
    assert (len(session.frame("episodes")), list(session.read(Episodes, -1))) == (0, [])  # none was found
    assert verify(tmp_path).findings == ()


@pytest.mark.parametrize("error", ["", "Press: ZeroDivisionError"])
async def test_the_description_is_written_first_and_completed_last(tmp_path: Path, error: str) -> None:
    run = new_run(describe={"rig": {"seed": 7, "split": "test"}})
    run.declaration = ("scores = TestSource(Scores)",)
    dataset = Dataset(tmp_path)
    await dataset.open(run)
    before = Session.open(tmp_path)
    assert before.about["complete"] is False
    assert before.about["sources"] == {"rig": {"seed": 7, "split": "test"}}
    assert before.about["split"] == "test"
    await dataset.write(new_batch(Labelled))
    run.sources["rig"] = SourceStatus(rows=5, late=2, gaps=[Gap(1, 2, "unplugged")])
    run.sinks["mqtt"] = SinkStatus(rows=5, dropped=1, failures=3)
    run.clock_steps.append(ClockStep(7, -3_600_000_000_000))
    run.error = error
    await dataset.close()
    session = Session.open(tmp_path)
    about: Any = session.about
    assert (about["complete"], about["error"]) == (not error, error or None)
    assert about["declaration"] == ["scores = TestSource(Scores)"]
    assert about["start"] == "2023-11-14T22:13:20.000000005Z"
    assert (about["start_ns"], about["end_ns"]) == (run.start, 1_700_000_060 * s)
    assert (about["session"], about["flow"]) == ("one", "slip")
    assert (about["sources"], about["split"]) == (before.about["sources"], "test")
    gap = {"start": 1, "end": 2, "reason": "unplugged"}
    assert about["streams"]["rig"] == {"rows": 5, "late": 2, "gaps": [gap]}
    assert about["sinks"]["mqtt"] == {"rows": 5, "dropped": 1, "failures": 3, "records": False}
    assert about["clock_steps"] == [{"time": 7, "offset": -3_600_000_000_000}]


def test_a_fingertip_numbered_by_numpy_is_recorded(tmp_path: Path) -> None:
    one, row = np.int64(1), np.arange(1)
    made = Slips(row, row.astype(np.int8), row, row / 8, finger=cast("int", one))
    listed = Slips.rows([1], 1, 1, 0.5, finger=cast("int", one))
    run_sink(Dataset(tmp_path), new_run(), [made, listed])
    assert Session.open(tmp_path).frame("slips")["finger"].to_list() == [1, 1]
    assert verify(tmp_path).findings == ()


@pytest.mark.parametrize("name", [".nfs0001", "000000 (copy).wal", "notes.txt"])
async def test_a_file_of_others_in_the_journal_stays_and_hinders_nothing(tmp_path: Path, name: str) -> None:
    dataset, folder = Dataset(tmp_path), tmp_path / "sessions/one"
    await dataset.open(new_run())
    await dataset.write(new_batch(Touch, 20))
    (folder / "journal" / name).write_text("mine")
    killed = copytree(folder, tmp_path / "killed")
    await dataset.close()
    for each in (folder, killed):
        assert len(Session.open(each).frame("touch")) == 20
        assert contents(each / "journal") == {name: b"mine"}
    assert Session.open(folder).about["complete"] is True
    assert verify(folder).code == 0


async def test_a_batch_without_a_table_is_refused_and_not_stored(tmp_path: Path) -> None:
    good, broken = new_batch(Touch), new_batch(Touch)
    broken = Touch(broken.time, broken.counts.astype(float), broken.temperature, broken.valid, finger=0)
    aside = Motion(*(getattr(new_batch(Motion), name) for name in columns(Motion)), finger=2)
    refused: list[tuple[Any, type[SlipflowError], str]] = [
        (new_batch(Zeroed), ParameterError, "'Zeroed', must be Touch: a session has either raw or zeroed"),
        (new_batch(Sample), ParameterError, "batch is 'Sample', must be one of Touch, .*Labelled"),
        (new_batch(Scores), ParameterError, "batch is 'Scores', must be one of"),
        (aside, ParameterError, "finger of a Motion is 2, must be EVERY"),
        (new_batch(Touch, finger=2**15), ParameterError, "finger of a Touch is 32768, must be from -1 to"),
        (broken, BatchError, r"Touch\.counts: is float64"),
    ]
    dataset = Dataset(tmp_path)
    await dataset.open(new_run())
    await dataset.write(good)
    for batch, error, complaint in refused:
        with pytest.raises(error, match=complaint):
            await dataset.write(batch)
    await dataset.close()
    session = Session.open(tmp_path)
    assert session.tables == ("touch",)
    assert len(session.frame("touch")) == len(good)


def test_a_place_that_cannot_be_written_to_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for place, complaint in (
        (tmp_path / "file", "file: is a file, must be a folder"),
        (tmp_path / "file/below", "below: cannot be written: Not a directory; a file exists where a"),
        (Path("/proc/slipflow"), "slipflow: cannot be written: No such file or directory"),
    ):
        with pytest.raises(EndpointError, match=complaint) as error:
            run_sink(Dataset(place), new_run(), [])
        assert "\n" not in str(error.value)
    assert (tmp_path / "file").read_text() == "mine"


def test_a_session_is_never_written_over(tmp_path: Path) -> None:
    run_sink(Dataset(tmp_path), new_run(), [new_batch(Touch)])
    with pytest.raises(EndpointError, match="already has a session 'one'"):
        run_sink(Dataset(tmp_path), new_run(), [])
    assert len(Session.open(tmp_path).frame("touch")) == 5
    dataset = Dataset(tmp_path)
    for name in ("two", "three"):  # one run after another
        run_sink(dataset, new_run(name), [new_batch(Zeroed)])
        [found] = Session.open(tmp_path / "sessions" / name).read(Touch, 0)
        assert type(found) is Zeroed
    assert session_names(tmp_path) == ["one", "three", "two"]


@pytest.mark.parametrize("value", [float("nan"), [float("inf")]])
def test_a_description_that_cannot_be_json_is_refused_at_the_start(tmp_path: Path, value: Json) -> None:
    with pytest.raises(InputError, match="description of source 'rig': is not JSON"):
        run_sink(Dataset(tmp_path), new_run(describe={"rig": {"rate": value}}), [])
    assert session_names(tmp_path) == []


async def stubborn(root: Path, batches: Iterable[Any]) -> None:
    """Record a replay as a runner does: each call that fails is repeated once."""

    async def insist(call: Callable[..., Coroutine[Any, Any, None]], *given: Any) -> None:
        try:
            await call(*given)
        except EndpointError:
            await call(*given)

    dataset = Dataset(root)
    dataset.part_span, dataset.part_rows = 100 * ms, 20
    await insist(dataset.open, new_run(live=False))
    for batch in batches:
        await insist(dataset.write, batch)
    await insist(dataset.close)


def test_a_failure_at_any_step_of_a_replay_costs_nothing_but_a_second_try(tmp_path: Path) -> None:
    streams: list[tuple[type[Batch], int]] = [*STREAMS, (Faults, 1)]
    batches = side_by_side(4, streams)
    steps = steps_of(lambda: asyncio.run(stubborn(tmp_path / "whole", batches)))
    assert len(steps) > 60
    for number in each_kind(steps, every=20):
        root, reached = tmp_path / str(number), list[str]()

        def fail(step: str, reached: list[str] = reached, number: int = number) -> None:
            reached.append(step)
            if len(reached) - 1 == number:
                raise OSError(28, "No space left on device")

        with observed(fail):
            asyncio.run(stubborn(root, batches))
        assert sum(rows(root, batches, streams)) == sum(map(len, batches)), steps[number]
        assert Session.open(root).about["complete"] is True
        assert [*root.rglob("*.tmp"), *root.rglob("journal")] == []


async def test_a_cancelled_write_without_a_journal_takes_nothing_and_spoils_nothing(tmp_path: Path) -> None:
    dataset = Dataset(tmp_path)
    dataset.part_span = s
    await dataset.open(new_run(live=False))
    await dataset.write(new_batch(Touch))
    with held("replace new part") as (writing, go_on):
        task = asyncio.create_task(dataset.write(new_batch(Touch, start=2 * s)))
        assert await asyncio.to_thread(writing.wait, 60)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        closing = asyncio.create_task(dataset.close())  # while the commit is still in its thread
        go_on.set()
        await closing
    assert Session.open(tmp_path).frame("touch")["time"].to_list() == [n * 10 * ms for n in range(5)]


async def test_a_slow_commit_makes_no_row_wait_until_a_whole_part_is_in_memory(tmp_path: Path) -> None:
    dataset = Dataset(tmp_path)
    dataset.part_span, dataset.part_rows = 100 * ms, 50
    await dataset.open(new_run())
    with held("fsync new part") as (writing, go_on):
        for number in range(60):  # 10 in the part that is committed; the others go to the journal
            await dataset.write(new_batch(Touch, 1, start=number * 10 * ms))
            assert dataset.pending <= 10
        assert await asyncio.to_thread(writing.wait, 60)
        full = asyncio.create_task(dataset.write(new_batch(Touch, 1, start=600 * ms)))
        await asyncio.to_thread(lambda: None)
        assert not full.done()
        killed = copytree(tmp_path / "sessions/one", tmp_path / "killed")
        go_on.set()
        await full
    assert len(Session.open(killed).frame("touch")) >= 50
    await dataset.close()
    session = Session.open(tmp_path)
    assert session.frame("touch")["time"].to_list() == [n * 10 * ms for n in range(61)]
    assert [part.rows for part in session.listed.values()] == [10, 50, 1]


async def test_a_stuck_disk_holds_up_the_writer_but_not_the_event_loop(tmp_path: Path) -> None:
    took = list[int]()

    async def write() -> None:
        for number in range(30):
            await dataset.write(new_batch(Touch, 1, start=number * 10 * ms))
            took.append(number)

    dataset = Dataset(tmp_path)
    await dataset.open(new_run())
    with held("pwrite segment") as (_, go_on):
        writing = asyncio.create_task(write())
        await until(lambda: len(took) == 10)
        for _ in range(100):
            await asyncio.sleep(0)
        assert len(took) == dataset.pending == 10  # what a kill could cost
        go_on.set()
        await writing
    await dataset.close()
    assert dataset.pending == 0
    assert len(Session.open(tmp_path).frame("touch")) == 30


def test_importing_storage_does_not_import_pyarrow_which_later_takes_memory_from_the_c_library() -> None:
    code = """
import storage, sys
print([each for each in ("pyarrow", "polars", "scipy") if each in sys.modules])
storage.arrow.load()
print(storage.arrow.pa.default_memory_pool().backend_name)
"""
    env = {name: value for name, value in os.environ.items() if name != "ARROW_DEFAULT_MEMORY_POOL"}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[]", "system"]


def test_one_of_many_processes_describes_a_dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def beaten(root: Path) -> Generator[None]:
        """By a process that held the lock when we asked for it."""
        files.put_json(root / "dataset.json", {"format": "slipflow dataset", "version": 2, "by": "another"})
        yield

    monkeypatch.setattr(files, "exclusive", beaten)
    describe_dataset(tmp_path)
    assert read_dataset(tmp_path)["by"] == "another"
