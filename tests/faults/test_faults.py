"""Deterministic simulation: no fault violates an invariant, and planted bugs are found."""

import asyncio
import subprocess
import sys
from pathlib import Path
from unittest.mock import patch

import pytest

from connectors.mqtt.outbox import Outbox
from connectors.mqtt.sender import Sender
from storage import Dataset
from tests.faults.planted_bugs import PLANTED
from tests.faults.schedule import KINDS, LOST_PAGES, RARE, Schedule, draw
from tests.faults.search import command, violations
from tests.faults.world import simulate

SCHEDULES = 100


def test_no_fault_violates_an_invariant() -> None:
    found = {seed: violations(draw(seed)) for seed in range(SCHEDULES)}
    assert not any(found.values()), "\n".join(
        f"{texts[0]}; replay and shrink: {command(seed)}" for seed, texts in found.items() if texts
    )


def test_the_schedules_have_every_kind_of_fault() -> None:
    assert {fault.kind for seed in range(SCHEDULES) for fault in draw(seed).faults} == set(KINDS)


def test_without_faults_one_run_records_and_delivers_everything() -> None:
    outcome = simulate(Schedule(0, ()))
    assert not outcome.violations
    assert outcome.events > 20
    assert outcome.rows > 150


@pytest.mark.parametrize(
    ("seed", "history"),
    [
        (34031, "a second failure of the disk prevents the repair of events before a kill"),
        (41966, "events are written again after two failed fsyncs"),
        (423695, "the disk fails again before rows are tried again"),
        (5287, "an fsync fails while a slow write of later events is in progress"),
        (1013437, "the broker forgets events that a full disk and memory did not keep"),
        (9424, "a fault of the disk ends while the host is stalled"),
        (2010093, "the disk works between two attempts to write events, but not during them"),
    ],
)
def test_a_history_that_once_violated_an_invariant_violates_none(seed: int, history: str) -> None:
    assert not violations(draw(seed)), history


def test_a_seed_gives_the_same_history_in_another_process() -> None:
    seeds = [0, 9, 18, 27]
    text = (
        "from tests.faults.schedule import draw; from tests.faults.world import simulate\n"
        f"print(*[simulate(draw(seed)).digest for seed in {seeds}])"
    )
    root = Path(__file__).parents[2]
    other = subprocess.run([sys.executable, "-c", text], cwd=root, capture_output=True, text=True, check=True)
    assert other.stdout.split() == [simulate(draw(seed)).digest for seed in seeds]


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_bug_is_found(name: str) -> None:
    seeds = range(RARE - 1, 400, RARE) if PLANTED[name].kinds == LOST_PAGES else range(300)
    assert any(violations(draw(seed, PLANTED[name].kinds), name) for seed in seeds), name


@pytest.mark.parametrize(
    ("owner", "method"),
    [
        (Outbox, "_keep_writing"),
        (Outbox, "_keep_syncing"),
        (Sender, "_keep_sending"),
        (Dataset, "_keep_syncing"),
    ],
)
@pytest.mark.parametrize("raises", [True, False])
def test_a_task_of_a_sink_that_dies_is_found_without_any_fault(
    owner: type, method: str, *, raises: bool
) -> None:
    async def die(*_: object) -> None:
        await asyncio.sleep(0.05)
        if raises:
            raise KeyError("planted")

    outcome = simulate(Schedule(0, ()), lambda stack: stack.enter_context(patch.object(owner, method, die)))
    assert any("a background task of the rig died" in each for each in outcome.violations)
    assert not any("killed" in each for each in outcome.violations)
