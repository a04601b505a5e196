import asyncio
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery, Entry
from flows.run.cluster.cluster_segment import segment
from flows.run.cluster.cutting import Cutter, shared
from flows.run.cluster.work_units import Claim
from flows.run.replay_runner import ReplayRunner
from operators import EVERY, Batch, InputError
from storage import Session

from .conftest import derive


class Counted(CompiledFlow):
    """A plan that counts the slices that it is given."""

    pushes = 0

    def push(self, batches: Mapping[Entry, Batch]) -> list[Delivery]:
        self.pushes += 1
        return super().push(batches)


def spans(claims: list[Claim], finger: int, source: str) -> list[tuple[str, int, int]]:
    """Where the rows of a stream are cut, slice by slice."""
    return [
        (rows.path, rows.start, rows.stop)
        for claim in claims
        if finger in claim.fingers
        for each in claim.slices
        for rows in each.rows
        if rows.source == source and rows.finger in (finger, EVERY)
    ]


def test_each_row_is_claimed_once_by_its_fingertip(folder: Path, tmp_path: Path) -> None:
    claims = Cutter(derive(tmp_path / "out"), folder, rows=130, slices=3).claims()
    for finger in (0, 1):
        found = spans(claims, finger, "touch")
        assert sum(stop - start for _, start, stop in found) == 4500
        assert all(before[2] == after[1] or after[1] == 0 for before, after in pairwise(found))


def test_shares_are_dealt_out_from_where_the_recording_is(folder: Path, tmp_path: Path) -> None:
    claims = Cutter(derive(tmp_path / "out"), folder, deal=5).claims()
    assert {(claim.share, claim.deal) for claim in claims} == {(0, 5), (1, 6)}


def test_fingertips_of_one_share_are_claimed_together(folder: Path, tmp_path: Path) -> None:
    claims = Cutter(derive(tmp_path / "out"), folder, rows=130, shares=1).claims()
    assert {(claim.share, claim.fingers) for claim in claims} == {(0, (0, 1))}
    for finger in (0, 1):
        assert sum(stop - start for _, start, stop in spans(claims, finger, "touch")) == 4500
    motion = [rows for claim in claims for each in claim.slices for rows in each.rows if rows.finger == EVERY]
    assert sum(rows.stop - rows.start for rows in motion) == 45 * 125


@pytest.mark.parametrize(
    ("most", "shares"),
    [(1, [(0, 2, 4, 6, 9)]), (2, [(0, 4, 9), (2, 6)]), (9, [(0,), (2,), (4,), (6,), (9,)])],
)
def test_shares_are_of_one_size_but_for_one_fingertip(
    most: int, shares: list[tuple[int, ...]], tmp_path: Path
) -> None:
    flow, fingers = derive(tmp_path), (0, 2, 4, 6, 9)
    segment_flow = segment(flow, {"touch": fingers, "motion": (EVERY,)})
    assert list(shared(segment_flow, most)) == shares


def test_motion_is_claimed_by_every_share(folder: Path, tmp_path: Path) -> None:
    claims = Cutter(derive(tmp_path / "out"), folder).claims()
    for finger in (0, 1):
        assert sum(stop - start for _, start, stop in spans(claims, finger, "motion")) == 45 * 125


def test_the_claims_of_a_share_are_numbered_and_the_last_tells_the_end(folder: Path, tmp_path: Path) -> None:
    claims = Cutter(derive(tmp_path / "out"), folder, rows=130, slices=3).claims()
    for finger in (0, 1):
        own = [claim for claim in claims if claim.fingers == (finger,)]
        assert [claim.number for claim in own] == list(range(len(own)))
        assert [claim.end is not None for claim in own] == [False] * (len(own) - 1) + [True]
        end = own[-1].end
        assert end
        assert end.shares == ((0,), (1,))
        assert end.claims == len(own)
        numbers = [
            each.number for claim in own for each in claim.slices
        ]  # those that hold nothing of it lack
        assert numbers == sorted(set(numbers))
        assert numbers[-1] < end.slices


def test_there_are_as_many_slices_as_a_replay_makes(folder: Path, tmp_path: Path) -> None:
    claims = Cutter(derive(tmp_path / "out"), folder).claims()
    plans = list[Counted]()

    def compile_flow(flow: Flow) -> CompiledFlow:
        plans.append(Counted(flow))
        return plans[0]

    asyncio.run(
        ReplayRunner(
            derive(tmp_path / "other"), Session.open(folder), "x", compile_flow=compile_flow
        ).execute()
    )
    assert claims[-1].end
    assert claims[-1].end.slices == plans[0].pushes


def test_a_recording_that_grows_gives_the_claims_of_the_whole(
    new_recorder: Callable[..., Any], tmp_path: Path
) -> None:
    recorder, flow = new_recorder(), derive(tmp_path / "out")
    growing = Cutter(flow, recorder.folder, rows=130, slices=3)
    claims = growing.claims(growing=True)
    for _ in range(4):
        recorder.record(11)
        claims += growing.claims(growing=True)
    assert claims
    before = growing.ended
    folder = recorder.close()
    claims += growing.claims(growing=True)
    assert (before, growing.ended) == (False, True)
    assert growing.claims(growing=True) == []
    assert claims == Cutter(flow, folder, rows=130, slices=3).claims()


def test_a_fingertip_that_comes_late_has_all_cut_anew(
    new_recorder: Callable[..., Any], tmp_path: Path
) -> None:
    recorder, flow = new_recorder(), derive(tmp_path / "out")
    growing = Cutter(flow, recorder.folder, rows=130, slices=3)
    recorder.record(25, (0,))
    assert {claim.turn for claim in growing.claims(growing=True)} == {0}
    recorder.record(25, (0, 5))
    folder = recorder.close()
    claims = growing.claims(growing=True)
    assert {claim.turn for claim in claims} == {1}
    whole = Cutter(flow, folder, rows=130, slices=3).claims()
    assert [(claim.fingers, claim.number, claim.slices) for claim in claims] == [
        (claim.fingers, claim.number, claim.slices) for claim in whole
    ]


def test_a_part_that_is_not_what_the_manifest_lists_is_named(folder: Path, tmp_path: Path) -> None:
    part = folder / "touch" / "part-000001.parquet"
    part.write_bytes(part.read_bytes()[:-1] + b"x")
    with pytest.raises(InputError, match=r"part-000001\.parquet: is damaged"):
        Cutter(derive(tmp_path / "out"), folder).claims()
