"""Records, or recovers, once for each step at which that can be cut off, and is killed there.

    kill_points.py record ROOT          ROOT/<step>-<turn>/ holds what each kill left
    kill_points.py replay ROOT          the same for what is not recorded live
    kill_points.py recover LEFT ROOT    the same for recoveries of copies of the session LEFT

Prints a JSON object: by step, how often one was killed there.
"""

import json
import os
import signal
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from shutil import copytree
from traceback import print_exc

import numpy as np

from operators.batch import BAROMETERS, Batch, Episodes, Motion, Slips, Touch, ms
from operators.ports import Run
from storage import journal, recovery, steps
from storage.writer import SessionWriter
from tests.storage.made import new_episodes

ROWS = 45  # of each stream
STROKE = 4  # rows of an episode
TURNS = (1, 3)  # which time a step is reached


class Clock:
    def now(self) -> int:
        return 0

    async def sleep_until(self, time: int) -> None:
        raise AssertionError(time)


def row(kind: type[Touch | Motion | Slips], number: int) -> Touch | Motion | Slips:
    time = np.array([number * 10 * ms])
    six = np.full((1, BAROMETERS), number)
    if kind is Touch:
        return Touch(time, six.astype(np.int16), six.astype(np.int16), six > 0, finger=0)
    if kind is Motion:
        return Motion(time, time, six.astype(float), six.astype(float))
    return Slips(time, np.array([number % 2], np.int8), time, np.array([number / 100]), finger=0)


def stroke(number: int) -> Episodes:
    """Return the episode that ends with row `number` of the streams."""
    return new_episodes(((number + 1 - STROKE) * 10 * ms, (number + 1) * 10 * ms, "tap"))


def record(root: Path, *, live: bool) -> None:
    """As a sink does; `taken` says how many rows of each stream were."""
    root.mkdir()
    (root / ".taken").write_bytes(b"")
    journal.SYNC_INTERVAL = 0.001  # type: ignore[misc] # s
    run = Run("one", "slip", Clock(), 0, live=live)
    writer = SessionWriter(root, run, part_span=100 * ms, part_rows=8)
    with (root / ".taken").open("ab", buffering=0) as taken:
        for number in range(ROWS):
            batches: list[Batch] = [row(kind, number) for kind in (Touch, Motion, Slips)]
            if number % STROKE == STROKE - 1:
                batches.append(stroke(number))
            for batch in batches:
                while writer.full(batch):
                    writer.commit()
                if not writer.add(batch):
                    writer.append(batch)
            taken.write(b".")
    writer.close()


def killed(turn: int, step: str, work: Callable[[], object]) -> bool:
    """Whether `work` reached the step so many times and was killed there."""
    child = os.fork()
    if child:
        _, status = os.waitpid(child, 0)
        if not os.WIFSIGNALED(status) and os.waitstatus_to_exitcode(status):
            raise SystemExit(f"{step}: {status}")
        return os.WIFSIGNALED(status)
    left = turn

    def reach(name: str) -> None:
        nonlocal left
        left -= name == step
        if not left:
            os.kill(os.getpid(), signal.SIGKILL)

    steps.reach = reach
    try:
        work()
    except BaseException:  # noqa: BLE001 - the parent has to hear of it
        print_exc()
        os._exit(1)
    os._exit(0)


def main() -> None:
    """Kill at each step."""
    import_module("storage.session_recovery")  # once, not after each fork
    left, root = Path(sys.argv[2]), Path(sys.argv[-1])
    counts = dict.fromkeys(steps.STEPS, 0)
    for step in steps.STEPS:
        for turn in TURNS:
            place = root / f"{step}-{turn}"
            if sys.argv[1] in {"record", "replay"}:
                live = sys.argv[1] == "record"
                counts[step] += killed(turn, step, partial(record, place, live=live))
            else:
                copytree(left, place)
                counts[step] += killed(turn, step, partial(recovery.recover, place))
    sys.stdout.write(json.dumps(counts))


if __name__ == "__main__":
    main()
