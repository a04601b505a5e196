"""Kills of `recover`: the next recovery ends with the same rows as one that was not killed."""

import signal
from functools import partial
from pathlib import Path
from shutil import copyfile, copytree, rmtree

import numpy as np

from operators import SlipflowError
from storage import recover, verify
from storage.recovery import scratch_files
from tests.chaos.child import PATIENCE
from tests.chaos.processes import scratch, start
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.chaos.session import Contents, begin, read, write
from tests.storage.disk_steps import steps_of

ROWS, PART = 60, 25  # of each stream; of a part
STATES = ("killed", "unlisted part", "torn")  # folders of sessions that need a recovery


def kills(scale: Scale) -> Promise:
    """Kill `recover` at random steps, then recover again."""
    random = np.random.default_rng(scale.seed)
    wanted, killed, sessions, wrong = 4 if scale.short else 100, 0, 0, list[str]()
    with scratch(memory=True) as folder:
        _leave(folder)
        steps = {state: _steps(folder, state) for state in STATES}
        expected = {state: _recovered(folder, state) for state in STATES}
        while killed < wanted:
            state = STATES[sessions % len(STATES)]
            copy = Path(copytree(folder / state, folder / "copy"))
            numbers = random.integers(steps[state], size=2).tolist()
            killed += sum(
                _kill(copy, number) for number in numbers
            )  # the second recovery may have fewer steps
            sessions += 1
            if reason := _difference(copy, expected[state]):
                wrong.append(f"; {state}, steps {numbers}: {reason}")
            rmtree(copy)
    whole = f"{sessions - len(wrong)} of {sessions} sessions have the rows and reported losses"
    return Promise(
        f"recovery: SIGKILL x{killed} of `recover`, once or twice in a session, at random ones of at most"
        f" {max(steps.values())} steps on the disk",
        f"{whole} of a recovery that was not killed{''.join(wrong)}",
        f"{sessions} of {sessions}",
        passed=not wrong,
    )


def _leave(folder: Path) -> None:
    """Leave the session of a killed recorder in three states."""
    writer = begin(folder / "data", part_rows=PART)
    for number in range(ROWS):
        write(writer, number)
    for state in STATES:
        copytree(writer.folder, folder / state)
    writer.close()
    copyfile(folder / "killed/touch/part-000000.parquet", folder / "unlisted part/touch/part-000002.parquet")
    newest = max((folder / "torn/journal").glob("0*.wal"))
    newest.write_bytes(newest.read_bytes()[:-5])


def _steps(folder: Path, state: str) -> int:
    copy = Path(copytree(folder / state, folder / "copy"))
    count = len(steps_of(partial(recover, copy)))
    rmtree(copy)
    return count


def _recovered(folder: Path, state: str) -> Contents:
    copy = Path(copytree(folder / state, folder / "copy"))
    recover(copy)
    contents = read(copy)
    rmtree(copy)
    return contents


def _kill(folder: Path, step: int) -> bool:
    """Recover a session in a process that is killed at a step; return False if it ended before."""
    child = start("recoverer", folder, str(step))
    try:
        _, stderr = child.communicate(timeout=PATIENCE)
    finally:
        child.kill()
    if child.returncode not in {0, -signal.SIGKILL}:
        raise RuntimeError(f"recover failed with {child.returncode}: {stderr}")
    return bool(child.returncode)


def _difference(folder: Path, expected: Contents) -> str:
    """Recover a session and return how it differs from what is expected; empty: it does not."""
    try:
        recover(folder)
        found = read(folder)
    except SlipflowError as error:
        return str(error)
    losses = [each.about["recovered"]["lost"] for each in (found, expected)]
    checks = {
        "rows": found.same(expected),
        "losses": losses[0] == losses[1],
        "verify": verify(folder).code in {0, 3},
        "left files": not scratch_files(folder) and not (folder / "journal").exists(),
    }
    return ", ".join(name for name, correct in checks.items() if not correct)


PROMISES = (kills,)
