import asyncio
from pathlib import Path

import numpy as np
import pytest

from flows.graph import Flow
from flows.run.cluster.assembly import assemble
from flows.run.cluster.cutting import Cutter
from flows.run.cluster.work_units import Claim, Done
from flows.run.cluster.worker import Work
from flows.run.replay_runner import ReplayRunner
from operators import EndpointError, InputError
from storage import Session

from .conftest import derive


def contents(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def worked(flow: Flow, place: Path, claims: list[Claim]) -> list[Done]:
    """Work off claims as an engine would; what is done."""
    work, states, found = Work(flow, place), dict[str, bytes](), list[Done]()
    for claim in claims:
        states[claim.key], done = work.take(states.get(claim.key), Claim.read(claim.line()))
        found += [done] if done else []
    return found


def finish(flow: Flow, place: Path, done: Done, out: Path) -> None:
    assemble(flow, {"dataset": str(out)}, "job", place / done.key, done)


@pytest.mark.parametrize(("rows", "slices", "shares"), [(1000, 8, 2), (1000, 1, 2), (1000, 3, 1)])
def test_claims_in_any_order_and_twice_give_the_files_of_one_process(
    rows: int, slices: int, shares: int, folder: Path, tmp_path: Path
) -> None:
    one = ReplayRunner(derive(tmp_path / "one"), Session.open(folder), "one")
    asyncio.run(one.execute())
    out = tmp_path / "many"
    flow = derive(out)
    claims = Cutter(flow, folder, rows, slices, shares).claims()
    mixed = [*claims, *claims[::3]]
    order: list[int] = np.random.default_rng(0).permutation(len(mixed)).tolist()
    mixed = [mixed[place] for place in order]
    done = worked(flow, tmp_path / "staged", mixed)
    assert sorted(each.share for each in done) == list(range(shares))
    finish(flow, tmp_path / "staged", done[-1], out)
    assert contents(out / "sessions") == contents(tmp_path / "one" / "sessions")


def test_slips_that_were_looked_for_and_not_found_are_the_file_of_one_process_too(
    folder: Path, tmp_path: Path
) -> None:
    one, out = tmp_path / "one", tmp_path / "many"
    asyncio.run(ReplayRunner(derive(one, 1.0), Session.open(folder), "one").execute())
    assert len(Session.open(one).frame("slips")) == 0
    flow = derive(out, 1.0)
    done = worked(flow, tmp_path / "staged", list(Cutter(flow, folder, 1000, 8, 2).claims()))
    finish(flow, tmp_path / "staged", done[-1], out)
    assert contents(out / "sessions") == contents(one / "sessions")


def test_work_that_is_done_again_from_any_state_writes_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    flow = derive(tmp_path / "out")
    claims = [each for each in Cutter(flow, folder, 130, 2).claims() if each.share == 1]
    worked(flow, tmp_path / "once", claims)
    states: list[bytes | None] = [None]
    for claim in claims:
        state, _ = Work(flow, tmp_path / "again").take(states[-1], claim)
        states.append(state)
    for number in range(len(claims)):
        Work(flow, tmp_path / "again").take(states[number], claims[number])
    assert contents(tmp_path / "again") == contents(tmp_path / "once")


def test_an_error_of_the_recording_ends_the_work_and_is_told(folder: Path, tmp_path: Path) -> None:
    flow = derive(tmp_path / "out")
    claims = Cutter(flow, folder, 130, 2).claims()
    (folder / "touch" / "part-000000.parquet").unlink()
    done = worked(flow, tmp_path / "staged", claims)
    assert {(each.share, each.end) for each in done} == {(0, None), (1, None)}
    assert all("part-000000.parquet: cannot be read" in each.error for each in done)


def test_a_disk_that_fails_is_for_the_engine_to_try_again(folder: Path, tmp_path: Path) -> None:
    flow = derive(tmp_path / "out")
    (tmp_path / "staged").write_text("in the way")
    with pytest.raises(EndpointError, match="cannot be written"):
        worked(flow, tmp_path / "staged", Cutter(flow, folder).claims())


def test_a_session_is_assembled_once(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "many"
    flow = derive(out)
    done = worked(flow, tmp_path / "staged", Cutter(flow, folder).claims())[-1]
    finish(flow, tmp_path / "staged", done, out)
    before = contents(out)
    finish(flow, tmp_path / "staged", done, out)
    assert contents(out) == before


def test_another_session_of_that_name_is_not_touched(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "many"
    flow = derive(out)
    done = worked(flow, tmp_path / "staged", Cutter(flow, folder).claims())[-1]
    (out / "sessions" / "one").mkdir(parents=True)
    (out / "sessions" / "one" / "MANIFEST.json").write_text("{}")
    with pytest.raises(InputError, match="is another session of that name"):
        finish(flow, tmp_path / "staged", done, out)
    assert [path.name for path in (out / "sessions" / "one").iterdir()] == ["MANIFEST.json"]


@pytest.mark.parametrize(("harm", "number"), [("cut", 0), ("gone", 0), ("gone", 9)])
def test_what_was_staged_and_is_damaged_is_named(
    harm: str, number: int, folder: Path, tmp_path: Path
) -> None:
    flow = derive(tmp_path / "many")
    done = worked(flow, tmp_path / "staged", Cutter(flow, folder, slices=2).claims())[-1]
    assert done.end
    assert done.end.claims == 10
    file = tmp_path / "staged" / done.key / "1" / f"{number:06d}.npz"
    if harm == "cut":
        file.write_bytes(file.read_bytes()[:-100])
    else:
        file.unlink()
    with pytest.raises(InputError, match=file.name):
        finish(flow, tmp_path / "staged", done, tmp_path / "many")
    assert not (tmp_path / "many" / "sessions" / "one").exists()
