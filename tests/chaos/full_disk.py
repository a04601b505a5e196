"""Full disk: only the recording stops, and it continues by itself when there is room."""

import json
import subprocess
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from operators import EVERY, Motion, Touch, concat, s
from storage import Session, verify
from storage.verification import LOSSY
from tests.chaos import fill
from tests.chaos.numbered import alike, motion, touch
from tests.chaos.processes import finish, scratch, start
from tests.chaos.run import Promise, Scale

SIZE = "1m"
DISKS = {"tmpfs": "a tmpfs of 1 MiB", "limit": "files may not grow; no tmpfs could be mounted"}


@dataclass(frozen=True)
class Kept:
    """Rows that can be read from the recording."""

    rows: int  # of touch, motion and samples
    wrong: int  # rows of touch and motion that differ from those produced
    newest: int  # number of the newest row of touch
    code: int  # exit code of verify


def full_for_a_while(scale: Scale) -> Sequence[Promise]:
    """Fill the disk, then free it."""
    full, room = (1.0, 1.5) if scale.short else (5.0, 5.0)
    with _small_disk() as (folder, how):
        report = _run(folder, how, full, room)
        found = _read(folder)
    during, after = (report[each][fill.NAME]["error"] for each in ("health", "after"))
    recovery = (
        "then recovery"
        if after is None and found.newest + 1 == report["produced"]["touch"]
        else "NO recovery"
    )
    return _promise(
        f"disk full for {full:g} s ({DISKS[how]}), then free again",
        report,
        found,
        f"health reports {(during or 'nothing').rpartition(': ')[2]!r}, {recovery}",
        also=during is not None and recovery == "then recovery",
    )


def full_until_the_end(scale: Scale) -> Sequence[Promise]:
    """Fill the disk until the run has ended, then free it and recover the session."""
    full = 1.0 if scale.short else 5.0
    with _small_disk() as (folder, how):
        report = _run(folder, how, full, 0)
        found = _read(folder)
    error = report["sink"][fill.NAME]["error"]
    return _promise(
        f"disk full until the end ({DISKS[how]}), then recovery",
        report,
        found,
        f"the run ends with {error.rpartition(': ')[2]!r}",
        also=bool(error),
    )


def _promise(claim: str, report: Any, found: Kept, observed: str, *, also: bool) -> Sequence[Promise]:  # noqa: ANN401 - JSON
    touch_rows, alerts, dropped = (
        report["produced"]["touch"],
        report["alerts"],
        report["sink"][fill.NAME]["dropped"],
    )
    lost = (
        touch_rows + report["produced"]["motion"] + touch_rows - found.rows - dropped
    )  # one sample for each row of touch
    passed = also and alerts == touch_rows and report["during"] > 0 and dropped > 0
    return [
        Promise(
            claim,
            f"{observed}; {alerts} of {touch_rows} alerts, {report['during']} while the disk was full;"
            f" {found.rows} rows readable, {found.wrong} wrong, {dropped} counted as dropped,"
            f" {lost} unaccounted for; `verify` exits with {found.code}",
            f"reported in health; all alerts; 0 wrong, 0 unaccounted for; `verify` exits with {LOSSY}",
            passed=passed and not lost and not found.wrong and found.code == LOSSY,
        )
    ]


def _run(folder: Path, how: str, full: float, room: float) -> Any:  # noqa: ANN401 - JSON
    return json.loads(finish(start("fill", folder, how, f"{full}", f"{room}"), full + room))


def _read(folder: Path) -> Kept:
    """Read the session, which is recovered first if it was not closed."""
    session = Session.open(folder / "data" / "sessions" / fill.SESSION)
    touch_rows = concat(Touch, list(session.read(Touch, 0)))
    motion_rows = concat(Motion, list(session.read(Motion, EVERY)))
    numbers = np.rint((touch_rows.time - touch_rows.time[0]) * fill.RATE / s).astype(np.int64)
    right = (
        alike(touch_rows, touch(numbers, touch_rows.time)),
        alike(motion_rows, motion(motion_rows.device_time, motion_rows.time)),
    )
    rising = [bool((np.diff(each) > 0).all()) for each in (numbers, motion_rows.device_time)]
    rows = len(touch_rows), len(motion_rows)
    wrong = sum(size for size, good, up in zip(rows, right, rising, strict=True) if not (good and up))
    samples = len(session.frame("samples"))
    return Kept(sum(rows) + samples, wrong, int(numbers[-1]), verify(session.folder).code)


@contextmanager
def _small_disk() -> Generator[tuple[Path, str]]:
    """Yield a folder, on a file system of 1 MiB if one can be mounted, and the way to fill it."""
    with scratch() as folder:
        command = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(folder)]
        try:
            mounted = not subprocess.run(command, capture_output=True, check=False).returncode
        except OSError:
            mounted = False
        try:
            yield folder, "tmpfs" if mounted else "limit"
        finally:
            if mounted:
                subprocess.run(["umount", "--lazy", str(folder)], capture_output=True, check=True)
