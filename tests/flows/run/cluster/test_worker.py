import asyncio
from pathlib import Path

import numpy as np
import pytest

from flows.graph import Flow
from flows.run.cluster.assembly import assemble
from flows.run.cluster.splitting import Splitter
from flows.run.cluster.work_units import ShareResult, WorkUnit
from flows.run.cluster.worker import Worker
from flows.run.replay_runner import ReplayRunner
from operators import EndpointError, InputError
from storage import Session

from .conftest import derive


def contents(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def processed(flow: Flow, place: Path, units: list[WorkUnit]) -> list[ShareResult]:
    """Process units as Flink does; return the results of the shares."""
    worker, states, found = Worker(flow, place), dict[str, bytes](), list[ShareResult]()
    for unit in units:
        states[unit.key], done = worker.process(states.get(unit.key), WorkUnit.from_line(unit.to_line()))
        found += [done] if done else []
    return found


def finish(flow: Flow, place: Path, done: ShareResult, out: Path) -> None:
    assemble(flow, {"dataset": str(out)}, "job", place / done.key, done)


@pytest.mark.parametrize(("rows", "slices", "shares"), [(1000, 8, 2), (1000, 1, 2), (1000, 3, 1)])
def test_units_in_any_order_and_repeated_give_the_files_of_one_process(
    rows: int, slices: int, shares: int, folder: Path, tmp_path: Path
) -> None:
    one = ReplayRunner(derive(tmp_path / "one"), Session.open(folder), "one")
    asyncio.run(one.execute())
    out = tmp_path / "many"
    flow = derive(out)
    units = Splitter(flow, folder, rows, slices, shares).units()
    mixed = [*units, *units[::3]]
    order: list[int] = np.random.default_rng(0).permutation(len(mixed)).tolist()
    mixed = [mixed[place] for place in order]
    done = processed(flow, tmp_path / "results", mixed)
    assert sorted(each.share for each in done) == list(range(shares))
    finish(flow, tmp_path / "results", done[-1], out)
    assert contents(out / "sessions") == contents(tmp_path / "one" / "sessions")


def test_an_empty_slips_table_equals_that_of_one_process(folder: Path, tmp_path: Path) -> None:
    one, out = tmp_path / "one", tmp_path / "many"
    asyncio.run(ReplayRunner(derive(one, 1.0), Session.open(folder), "one").execute())
    assert len(Session.open(one).frame("slips")) == 0
    flow = derive(out, 1.0)
    done = processed(flow, tmp_path / "results", list(Splitter(flow, folder, 1000, 8, 2).units()))
    finish(flow, tmp_path / "results", done[-1], out)
    assert contents(out / "sessions") == contents(one / "sessions")


def test_a_unit_processed_again_from_its_state_writes_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    flow = derive(tmp_path / "out")
    units = [each for each in Splitter(flow, folder, 400, 2).units() if each.share == 1]
    assert len(units) > 3
    processed(flow, tmp_path / "once", units)
    states: list[bytes | None] = [None]
    for unit in units:
        state, _ = Worker(flow, tmp_path / "again").process(states[-1], unit)
        states.append(state)
    for number in range(len(units)):
        Worker(flow, tmp_path / "again").process(states[number], units[number])
    assert contents(tmp_path / "again") == contents(tmp_path / "once")


def test_an_error_of_the_recording_ends_its_shares(folder: Path, tmp_path: Path) -> None:
    flow = derive(tmp_path / "out")
    units = Splitter(flow, folder, 130, 2).units()
    (folder / "touch" / "part-000000.parquet").unlink()
    done = processed(flow, tmp_path / "results", units)
    assert {(each.share, each.end) for each in done} == {(0, None), (1, None)}
    assert all("part-000000.parquet: cannot be read" in each.error for each in done)


def test_a_write_error_is_raised_for_flink_to_retry(folder: Path, tmp_path: Path) -> None:
    flow = derive(tmp_path / "out")
    (tmp_path / "results").write_text("in the way")
    with pytest.raises(EndpointError, match="cannot be written"):
        processed(flow, tmp_path / "results", Splitter(flow, folder).units())


def test_a_session_is_assembled_once(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "many"
    flow = derive(out)
    done = processed(flow, tmp_path / "results", Splitter(flow, folder).units())[-1]
    finish(flow, tmp_path / "results", done, out)
    before = contents(out)
    finish(flow, tmp_path / "results", done, out)
    assert contents(out) == before


def test_another_session_of_the_same_name_is_not_changed(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "many"
    flow = derive(out)
    done = processed(flow, tmp_path / "results", Splitter(flow, folder).units())[-1]
    (out / "sessions" / "one").mkdir(parents=True)
    (out / "sessions" / "one" / "MANIFEST.json").write_text("{}")
    with pytest.raises(InputError, match="another session has this name"):
        finish(flow, tmp_path / "results", done, out)
    assert [path.name for path in (out / "sessions" / "one").iterdir()] == ["MANIFEST.json"]


@pytest.mark.parametrize(("harm", "number"), [("cut", 0), ("gone", 0), ("gone", 9)])
def test_a_damaged_result_is_named(harm: str, number: int, folder: Path, tmp_path: Path) -> None:
    flow = derive(tmp_path / "many")
    done = processed(flow, tmp_path / "results", Splitter(flow, folder, slices=2).units())[-1]
    assert done.end
    assert done.end.units == 10
    file = tmp_path / "results" / done.key / "1" / f"{number:06d}.result"
    if harm == "cut":
        file.write_bytes(file.read_bytes()[:-100])
    else:
        file.unlink()
    with pytest.raises(InputError, match=file.name):
        finish(flow, tmp_path / "results", done, tmp_path / "many")
    assert not (tmp_path / "many" / "sessions" / "one").exists()
