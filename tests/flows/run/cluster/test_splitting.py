import asyncio
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from connectors import Console
from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery, Entry
from flows.graph.testing import TestSource
from flows.run.cluster.splitting import Splitter, check_flow, split_fingers
from flows.run.cluster.work_units import WorkUnit
from flows.run.cluster.worker import UnitSource
from flows.run.replay_runner import ReplayRunner
from operators import (
    EVERY,
    Align,
    Batch,
    Debounce,
    FlowError,
    InputError,
    Label,
    Motion,
    Score,
    Touch,
    Zero,
)
from storage import Dataset, Session, load_detector

from .conftest import derive


class Counted(CompiledFlow):
    """Compiled flow that counts its slices."""

    pushes = 0

    def push(self, batches: Mapping[Entry, Batch]) -> list[Delivery]:
        self.pushes += 1
        return super().push(batches)


def spans(units: list[WorkUnit], finger: int, source: str) -> list[tuple[str, int, int]]:
    """Return the row ranges of a stream, slice by slice."""
    return [
        (rows.path, rows.start, rows.stop)
        for unit in units
        if finger in unit.fingers
        for each in unit.slices
        for rows in each
        if rows.source == source and rows.finger in (finger, EVERY)
    ]


def test_each_row_is_in_one_unit_of_its_fingertip(folder: Path, tmp_path: Path) -> None:
    units = Splitter(derive(tmp_path / "out"), folder, rows=130, slices=3).units()
    for finger in (0, 1):
        found = spans(units, finger, "touch")
        assert sum(stop - start for _, start, stop in found) == 4500
        assert all(before[2] == after[1] or after[1] == 0 for before, after in pairwise(found))


def test_the_receivers_of_shares_follow_the_number_of_the_recording(folder: Path, tmp_path: Path) -> None:
    units = Splitter(derive(tmp_path / "out"), folder, number=5).units()
    assert {(unit.share, unit.receiver) for unit in units} == {(0, 5), (1, 6)}


def test_fingertips_of_one_share_are_in_the_same_units(folder: Path, tmp_path: Path) -> None:
    units = Splitter(derive(tmp_path / "out"), folder, rows=130, shares=1).units()
    assert {(unit.share, unit.fingers) for unit in units} == {(0, (0, 1))}
    for finger in (0, 1):
        assert sum(stop - start for _, start, stop in spans(units, finger, "touch")) == 4500
    motion = [rows for unit in units for each in unit.slices for rows in each if rows.finger == EVERY]
    assert sum(rows.stop - rows.start for rows in motion) == 45 * 125


@pytest.mark.parametrize(
    ("most", "shares"),
    [(1, [(0, 2, 4, 6, 9)]), (2, [(0, 4, 9), (2, 6)]), (9, [(0,), (2,), (4,), (6,), (9,)])],
)
def test_sizes_of_shares_differ_by_at_most_one_fingertip(
    most: int, shares: list[tuple[int, ...]], tmp_path: Path
) -> None:
    given = {"touch": UnitSource(Touch, (0, 2, 4, 6, 9)), "motion": UnitSource(Motion, (EVERY,))}
    flow = derive(tmp_path).replaced(lambda node: given.get(node.name, node.part))
    assert list(split_fingers(flow, most)) == shares


def test_motion_is_in_the_units_of_every_share(folder: Path, tmp_path: Path) -> None:
    units = Splitter(derive(tmp_path / "out"), folder).units()
    for finger in (0, 1):
        assert sum(stop - start for _, start, stop in spans(units, finger, "motion")) == 45 * 125


def test_the_units_of_a_share_are_numbered_and_the_last_has_the_end(folder: Path, tmp_path: Path) -> None:
    units = Splitter(derive(tmp_path / "out"), folder, rows=130, slices=3).units()
    for finger in (0, 1):
        own = [unit for unit in units if unit.fingers == (finger,)]
        assert [unit.number for unit in own] == list(range(len(own)))
        assert [unit.end is not None for unit in own] == [False] * (len(own) - 1) + [True]
        end = own[-1].end
        assert end
        assert end.shares == 2
        assert end.units == len(own)
        assert sum(len(unit.slices) for unit in own) == end.slices


def test_there_are_as_many_slices_as_in_a_replay(folder: Path, tmp_path: Path) -> None:
    units = Splitter(derive(tmp_path / "out"), folder).units()
    plans = list[Counted]()

    def compile_flow(flow: Flow) -> CompiledFlow:
        plans.append(Counted(flow))
        return plans[0]

    asyncio.run(
        ReplayRunner(
            derive(tmp_path / "other"), Session.open(folder), "x", compile_flow=compile_flow
        ).execute()
    )
    assert units[-1].end
    assert units[-1].end.slices == plans[0].pushes


def test_a_growing_recording_gives_the_units_of_the_complete_one(
    new_recorder: Callable[..., Any], tmp_path: Path
) -> None:
    recorder, flow = new_recorder(), derive(tmp_path / "out")
    growing = Splitter(flow, recorder.folder, rows=130, slices=3)
    units = growing.units(growing=True)
    for _ in range(4):
        recorder.record(11)
        units += growing.units(growing=True)
    assert units
    before = growing.ended
    folder = recorder.close()
    units += growing.units(growing=True)
    assert (before, growing.ended) == (False, True)
    assert growing.units(growing=True) == []
    assert units == Splitter(flow, folder, rows=130, slices=3).units()


def test_a_late_fingertip_starts_a_new_generation(new_recorder: Callable[..., Any], tmp_path: Path) -> None:
    recorder, flow = new_recorder(), derive(tmp_path / "out")
    growing = Splitter(flow, recorder.folder, rows=130, slices=3)
    recorder.record(25, (0,))
    assert {unit.generation for unit in growing.units(growing=True)} == {0}
    recorder.record(25, (0, 5))
    folder = recorder.close()
    units = growing.units(growing=True)
    assert {unit.generation for unit in units} == {1}
    whole = Splitter(flow, folder, rows=130, slices=3).units()
    assert [(unit.fingers, unit.number, unit.slices) for unit in units] == [
        (unit.fingers, unit.number, unit.slices) for unit in whole
    ]


def test_a_part_that_differs_from_the_manifest_is_named(folder: Path, tmp_path: Path) -> None:
    part = folder / "touch" / "part-000001.parquet"
    part.write_bytes(part.read_bytes()[:-1] + b"x")
    with pytest.raises(InputError, match=r"part-000001\.parquet: is damaged"):
        Splitter(derive(tmp_path / "out"), folder).units()


def test_units_name_only_the_rows_that_events_need(folder: Path, tmp_path: Path) -> None:
    flow, dataset = Flow("f"), Dataset(tmp_path / "out")
    zeroed = flow.source(TestSource(Touch)) | Zero()
    (zeroed & flow.source(TestSource(Motion)) | Align() | Label()).to(dataset)
    (zeroed | Score(load_detector("psd")) | Debounce()).to(dataset)
    units = Splitter(flow, folder).units()
    assert {rows.source for unit in units for each in unit.slices for rows in each} == {"touch"}


def test_a_flow_without_events_has_one_share_without_rows(folder: Path, tmp_path: Path) -> None:
    flow, dataset = Flow("labels"), Dataset(tmp_path / "out")
    zeroed = flow.source(TestSource(Touch)) | Zero()
    (zeroed & flow.source(TestSource(Motion)) | Align() | Label()).to(dataset)
    units = Splitter(flow, folder).units()
    assert {(unit.share, unit.fingers) for unit in units} == {(0, ())}
    assert not any(rows for unit in units for rows in unit.slices)


def test_a_sink_other_than_a_dataset_is_an_error() -> None:
    flow = Flow("f")
    (flow.source(TestSource(Touch)) | Zero() | Score(load_detector("psd")) | Debounce()).to(Console())
    with pytest.raises(FlowError, match="console: a cluster writes datasets only"):
        check_flow(flow)


def test_a_flow_without_operators_before_datasets_is_an_error(tmp_path: Path) -> None:
    flow = Flow("f")
    flow.source(TestSource(Touch)).to(Dataset(tmp_path))
    with pytest.raises(FlowError, match="none takes the rows of an operator"):
        check_flow(flow)
