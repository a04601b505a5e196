"""Deterministic simulation: no fault violates an invariant, and planted bugs are found."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.faults.planted_bugs import PLANTED
from tests.faults.schedule import KINDS, Fault, Schedule, draw, shrink
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


def test_events_may_be_lost_if_a_second_failure_of_the_disk_prevents_their_repair_before_a_kill() -> None:
    assert not violations(draw(34031))


def test_events_written_again_after_two_failed_fsyncs_are_found_by_the_next_run() -> None:
    assert not violations(draw(41966))


def test_a_seed_gives_the_same_history_in_another_process() -> None:
    seeds = [seed for seed in range(30) if seed % 3 == 0]
    text = (
        "from tests.faults.schedule import draw; from tests.faults.world import simulate\n"
        f"print(*[simulate(draw(seed)).digest for seed in {seeds}])"
    )
    root = Path(__file__).parents[2]
    other = subprocess.run([sys.executable, "-c", text], cwd=root, capture_output=True, text=True, check=True)
    assert other.stdout.split() == [simulate(draw(seed)).digest for seed in seeds]


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_bug_is_found(name: str) -> None:
    schedules = (draw(seed, PLANTED[name].kinds) for seed in range(100))
    if name == "a failed fsync is ignored":  # several such failures excuse the loss of almost all rows
        faults = Fault("fsync error", 0.2, 0.2, 0.5), Fault("power loss", 1.45, 0.0, 0.5)
        schedules = (Schedule(seed, faults) for seed in range(100))
    assert any(violations(schedule, name) for schedule in schedules), name


def test_a_schedule_is_shrunk_to_the_faults_that_matter() -> None:
    name = "unsent events are deleted"
    seed = next(seed for seed in range(100) if len(draw(seed).faults) > 3 and violations(draw(seed), name))
    schedule = draw(seed)
    fewest = shrink(schedule, lambda fewer: bool(violations(fewer, name)))
    assert len(fewest.faults) < len(schedule.faults)
    assert violations(fewest, name)
    for index in range(len(fewest.faults)):
        fewer = replace(fewest, faults=fewest.faults[:index] + fewest.faults[index + 1 :])
        assert not violations(fewer, name), "each remaining fault is needed"
