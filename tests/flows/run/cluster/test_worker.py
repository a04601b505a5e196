import asyncio
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flows.graph import Flow
from flows.graph.testing import TestSource
from flows.run.cluster.assembly import assemble
from flows.run.cluster.splitting import Splitter
from flows.run.cluster.work_units import UnitResult
from flows.run.cluster.worker import Worker
from flows.run.replay_runner import ReplayRunner
from operators import Align, Debounce, InputError, Label, Motion, Score, Slips, Touch, WatchClock, Zero
from operators.ports import Sink
from storage import Dataset, Session, load_detector

from .conftest import derive, processed


def contents(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def finish(flow: Flow, done: tuple[UnitResult, list[list[UnitResult]]]) -> None:
    last, shares = done
    slices = [iter([each for result in share for each in result.slices]) for share in shares]
    assemble(
        flow,
        {node.name: node.part.destination for node in flow.sinks() if isinstance(node.part, Sink)},
        "job",
        last,
        slices,
    )


def labels(out: Path) -> Flow:
    """Declare a flow without events."""
    flow = Flow("labels")
    zeroed = flow.source(TestSource(Touch)) | Zero()
    (zeroed & flow.source(TestSource(Motion)) | Align() | Label()).to(Dataset(out, host="test"))
    return flow


def events(out: Path) -> Flow:
    """Declare a flow with events of single fingertips and of all, before and after their rows."""
    flow, dataset = Flow("events"), Dataset(out, host="test")
    motion, zeroed = flow.source(TestSource(Motion)), flow.source(TestSource(Touch)) | Zero()
    (motion | WatchClock()).to(dataset)
    (zeroed | Score(load_detector("psd")) | Debounce()).to(dataset)
    zeroed.to(dataset)
    (zeroed | Score(load_detector("tcn")) | Debounce()).to(Dataset(out.with_name("other"), host="test"))
    return flow


@pytest.mark.parametrize(
    ("declared", "rows", "slices", "shares"),
    [
        (derive, 1000, 8, 2),
        (derive, 1000, 1, 2),
        (derive, 1000, 3, 1),
        (labels, 1000, 2, 2),
        (events, 1000, 2, 3),
    ],
)
def test_units_in_any_order_and_repeated_give_the_files_of_one_process(
    declared: Callable[[Path], Flow], rows: int, slices: int, shares: int, *, folder: Path, tmp_path: Path
) -> None:
    asyncio.run(ReplayRunner(declared(tmp_path / "one" / "out"), Session.open(folder), "one").execute())
    flow = declared(tmp_path / "many" / "out")
    units = Splitter(flow, folder, rows, slices, shares).units()
    mixed = [*units, *units[::3]]
    order: list[int] = np.random.default_rng(0).permutation(len(mixed)).tolist()
    [done] = processed(flow, [mixed[place] for place in order])
    finish(flow, done)
    assert contents(tmp_path / "many") == contents(tmp_path / "one")


def test_an_empty_slips_table_equals_that_of_one_process(folder: Path, tmp_path: Path) -> None:
    one, out = tmp_path / "one", tmp_path / "many"
    asyncio.run(ReplayRunner(derive(one, 1.0), Session.open(folder), "one").execute())
    assert len(Session.open(one).frame("slips")) == 0
    flow = derive(out, 1.0)
    [done] = processed(flow, Splitter(flow, folder, shares=2).units())
    finish(flow, done)
    assert contents(out / "sessions") == contents(one / "sessions")


def test_results_have_only_events(folder: Path, tmp_path: Path) -> None:
    flow = derive(tmp_path / "out")
    [(_, shares)] = processed(flow, Splitter(flow, folder).units())
    kinds = {
        type(batch)
        for share in shares
        for result in share
        for each in result.slices
        for batch in each.values()
    }
    assert kinds == {Slips}


def test_a_unit_processed_again_from_its_state_gives_the_same_result(folder: Path, tmp_path: Path) -> None:
    flow = derive(tmp_path / "out")
    units = [each for each in Splitter(flow, folder, 400, 2).units() if each.share == 1]
    assert len(units) > 3
    state: bytes | None = None
    for unit in units:
        (after, [result]), (_, [again]) = (Worker(flow).process(state, unit) for _ in range(2))
        assert result.to_line() == again.to_line()
        state = after


def test_an_error_of_the_recording_ends_its_shares(folder: Path, tmp_path: Path) -> None:
    flow = derive(tmp_path / "out")
    units = Splitter(flow, folder, 130, 2).units()
    (folder / "touch" / "part-000000.parquet").unlink()
    done = [last for last, _ in processed(flow, units)]
    assert [(each.unit.share, each.unit.number) for each in done] == [(0, 0), (1, 0)]
    assert all("part-000000.parquet: cannot be read" in each.error for each in done)


def test_a_session_is_written_once(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "many"
    flow = derive(out)
    [done] = processed(flow, Splitter(flow, folder).units())
    finish(flow, done)
    before = contents(out)
    finish(flow, done)
    assert contents(out) == before


def test_another_session_of_the_same_name_is_not_changed(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "many"
    flow = derive(out)
    [done] = processed(flow, Splitter(flow, folder).units())
    (out / "sessions" / "one").mkdir(parents=True)
    (out / "sessions" / "one" / "MANIFEST.json").write_text("{}")
    with pytest.raises(InputError, match="another session has this name"):
        finish(flow, done)
    assert [path.name for path in (out / "sessions" / "one").iterdir()] == ["MANIFEST.json"]


def test_a_recording_that_has_grown_is_an_error(folder: Path, tmp_path: Path) -> None:
    flow = derive(tmp_path / "many")
    [(last, shares)] = processed(flow, Splitter(flow, folder).units())
    assert last.unit.end
    end = last.unit.end._replace(slices=last.unit.end.slices - 1)
    fewer = replace(last, unit=replace(last.unit, end=end))
    with pytest.raises(InputError, match="has changed since the job began"):
        finish(flow, (fewer, shares))
    assert not (tmp_path / "many" / "sessions" / "one").exists()
