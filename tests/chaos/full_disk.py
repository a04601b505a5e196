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
from tests.chaos import children
from tests.chaos.numbered import alike, motion, touch
from tests.chaos.processes import Child, scratch
from tests.chaos.run import Promise, Scale

SIZE = "1m"
DISKS = {"tmpfs": "a tmpfs of 1 MiB", "limit": "files may not grow; no tmpfs could be mounted"}


@dataclass(frozen=True)
class Kept:
    """Rows that can be read from the recording."""

    rows: int
    wrong: int  # rows that differ from those produced
    newest: int  # number of the newest row of touch
    code: int  # exit code of verify


def full_for_a_while(scale: Scale) -> Sequence[Promise]:
    """Fill the disk, then free it."""
    full, room = (1.0, 1.5) if scale.short else (5.0, 5.0)
    with _small_disk() as (folder, how):
        report = _run(folder, how, full, room)
        found = _read(folder)
    during, after = (report[each][children.NAME]["error"] for each in ("health", "after"))
    (touch_rows, motion_rows), alerts = report["produced"], report["alerts"]
    dropped = report["sink"][children.NAME]["dropped"]
    lost = touch_rows + motion_rows - found.rows - dropped
    recovered = after is None and found.newest + 1 == touch_rows
    passed = during is not None and alerts == touch_rows and report["during"] > 0 and dropped > 0
    return [
        Promise(
            f"disk full for {full:g} s ({DISKS[how]}), then free again",
            f"health reports {(during or 'nothing').rpartition(': ')[2]!r}, then {'' if recovered else 'NO '}"
            f"recovery; {alerts} of {touch_rows} alerts, {report['during']} while the disk was full;"
            f" {found.rows} rows readable, {found.wrong} wrong, {dropped} counted as dropped,"
            f" {lost} unaccounted for; `verify` exits with {found.code}",
            "reported in health; all alerts; 0 wrong, 0 unaccounted for; `verify` exits with 3",
            passed=passed and recovered and not lost and not found.wrong and found.code == 3,
        )
    ]


def _run(folder: Path, how: str, full: float, room: float) -> Any:
    child = Child(folder, "fill", folder, how, f"{full}", f"{room}")
    child.start()
    child.stop(None)
    return json.loads(child.lines[-1])


def _read(folder: Path) -> Kept:
    """Read the session, which is recovered first if it was not closed."""
    session = Session.open(folder / "data" / "sessions" / children.SESSION)
    touch_rows = concat(Touch, list(session.read(Touch, 0)))
    motion_rows = concat(Motion, list(session.read(Motion, EVERY)))
    numbers = np.rint((touch_rows.time - touch_rows.time[0]) * children.RATE / s).astype(np.int64)
    right = (
        alike(touch_rows, touch(numbers, touch_rows.time)),
        alike(motion_rows, motion(motion_rows.device_time, motion_rows.time)),
    )
    rising = [bool((np.diff(each) > 0).all()) for each in (numbers, motion_rows.device_time)]
    rows = len(touch_rows), len(motion_rows)
    wrong = sum(size for size, good, up in zip(rows, right, rising, strict=True) if not (good and up))
    return Kept(sum(rows), wrong, int(numbers[-1]), verify(session.folder).code)


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
