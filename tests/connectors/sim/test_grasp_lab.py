import numpy as np
import pytest

from connectors.sim.grasp_actions import Lift
from connectors.sim.grasp_source import open_grasp
from connectors.sim.objects import named
from operators import Commands, s
from tests.connectors.sim.grasp_lab import GraspLab

BOX = named("box")
START = 1_700_000_000 * s


def test_a_lab_feels_on_the_hosts_clock_and_obeys_from_a_commands_time_on() -> None:
    now = [START]
    lab = GraspLab(open_grasp(BOX, 0, Lift(5.0)), now=lambda: now[0])
    lab.command(Commands(np.array([START + s // 2]), np.array([5.0]), np.full((1, 6), np.nan)))
    before, _ = lab.touch(0, START + s // 2)
    after, temperature = lab.touch(0, START + 2 * s)
    assert (after < before - 20).any()  # counts fall as pressure rises
    assert (temperature > 0).all()
    assert lab.states[-1].force == pytest.approx(5.0, rel=0.02)


def test_a_lab_gives_the_newest_reading_to_who_asks_too_soon_or_for_the_past() -> None:
    lab = GraspLab(open_grasp(BOX, 0, Lift(5.0)), now=lambda: START)
    newest, _ = lab.touch(0, START + s)
    for time in (START + s + 100, START):
        again, _ = lab.touch(0, time)
        assert (again == newest).all()
