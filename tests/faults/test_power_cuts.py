"""A power cut or kill at any operation on the disk leaves the durable rows, and never a wrong one."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from errno import EIO
from functools import partial
from pathlib import Path
from random import Random
from shutil import copytree
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from flows.run.session_output import new_session
from operators import concat
from operators.errors import EndpointError
from storage import Session, recover, verify
from tests.faults.simulated_disk import SimulatedDisk
from tests.faults.simulated_process import Killed, SimulatedProcess
from tests.faults.world import MEMORY
from tests.storage.disk_steps import ROWS, STREAMS, observed, record, row
from tests.storage.made import leave, new_run, rows, same, session_names, side_by_side

EVERY_NTH = 11  # operation at which the power is cut


@pytest.fixture
def root() -> Iterator[Path]:
    """A folder in memory, where inode numbers are not used again, as the simulated disk requires."""
    with TemporaryDirectory(prefix="faults-", dir=MEMORY if MEMORY.is_dir() else None) as folder:
        yield Path(folder)


def cut(folder: Path, number: int, work: Callable[[], object], *, power: bool = True) -> int:
    """Do a piece of work up to an operation, cut the power, and return the number of operations."""
    folder.mkdir(exist_ok=True)
    disk, process = SimulatedDisk(folder, Random(number)), SimulatedProcess("rig")
    disk.kill_in = number
    with disk.attached(), suppress(Killed):
        process.run(work)
    if number and power:
        disk.lose_power()
    return disk.operations


def counted(session: Session) -> list[int]:
    """The number of rows of each stream, after each was compared with the row that was recorded."""
    counts = list[int]()
    for kind, finger in STREAMS:
        found = concat(kind, list(session.read(kind, finger)))
        same(found, concat(kind, [row(kind, number) for number in range(len(found))]))
        counts.append(len(found))
    return counts


def test_a_power_cut_of_a_recording_loses_no_durable_row(root: Path) -> None:
    operations = cut(root / "whole", 0, partial(record, root / "whole/data", new_run(), []))
    assert operations > 200
    for number in range(1, operations, EVERY_NTH):
        folder, durable = root / str(number), [0]
        cut(folder, number, partial(record, folder / "data", new_run(), [], durable))
        if durable[-1] or (folder / "data/sessions/one/session.json").exists():
            assert min(counted(Session.open(folder / "data"))) >= durable[-1], number


def replay(root: Path) -> None:
    with new_session(root, "one") as scratch:
        record(scratch, new_run(live=False), [])


def test_a_power_cut_of_a_replay_leaves_it_complete_or_absent(root: Path) -> None:
    complete = 0
    operations = cut(root / "whole", 0, partial(replay, root / "whole/data"))
    for number in [*range(1, operations, EVERY_NTH), operations + 1]:  # the last is after its end
        folder = root / str(number)
        cut(folder, number, partial(replay, folder / "data"))
        if (folder / "data/sessions/one").exists():
            session = Session.open(folder / "data")
            assert (session.about["complete"], counted(session)) == (True, [ROWS] * len(STREAMS)), number
            assert verify(folder / "data").code == 0, number
            complete += 1
    assert complete


def test_a_replay_whose_fsync_failed_is_absent(root: Path) -> None:
    def fail(step: str) -> None:
        if step == "fsync part":
            raise OSError(EIO, "Input/output error")

    with observed(fail), pytest.raises(EndpointError, match="Input/output error"):
        replay(root)
    assert session_names(root) == []


def test_a_recovery_killed_at_any_operation_is_carried_out_by_the_next(root: Path) -> None:
    batches = side_by_side(5)
    left = leave(root / "data", new_run(), batches)
    operations = cut(root / "whole", 0, partial(recover, copytree(left, root / "whole")))
    assert operations > 40
    for number in range(1, operations + 1):
        folder = copytree(left, root / str(number))
        cut(folder, number, partial(recover, folder), power=False)
        recover(folder)
        assert rows(folder, batches) == [25] * 5, number
        about: Any = Session.open(folder).about
        assert about["recovered"]["rows"] == {"touch": 10, "motion": 5, "samples": 5, "slips": 25}
