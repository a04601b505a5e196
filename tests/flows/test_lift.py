"""The lift as a declared flow: on the simulated grasp, and over the real protocols."""

import asyncio
from collections.abc import Sequence
from contextlib import ExitStack

import pytest

from connectors import Gripper, TakkTile
from connectors.emulators.gripper_mechanism import Mechanism
from connectors.emulators.gripper_server import GripperServer
from connectors.emulators.lab_loop import loop_clock, run_lab
from connectors.gripper.grip_force import ForceScale
from connectors.sim.grasp import GraspState, least_force
from connectors.sim.grasp_actions import Lift
from connectors.sim.grasp_source import SimulatedGrasp, open_grasp
from connectors.sim.objects import OBJECTS, named
from flows.graph import Flow
from flows.graph.loading import load
from flows.graph.testing import TestSink, run_virtually
from flows.graph.validation import problems
from flows.lift import declare_grip, grip_controller, lift
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from operators import Commands, Grip, InputError, ParameterError, Run, s
from storage import load_detector
from tests.connectors.emulators.faulty_i2c import FaultyI2cBus
from tests.connectors.sim.grasp_lab import GraspLab

DETECTOR = "tcn_grasp"
UP = Lift(5.5)  # the gripper wakes up, the baseline is taken, the fingers close
SECONDS = 8
SMALL = ForceScale(((0, 0.05), (255, 10.0)))  # N: this scene's objects are held with a tenth of a real one's


def _for(flow: Flow, seconds: int) -> Run:
    async def main() -> Run:
        clock = LoopClock(1_700_000_000 * s)
        return await LiveRunner(flow, "test", clock=clock, duration=seconds * s).execute()

    return run_virtually(main())


def _is_held(last: GraspState) -> bool:
    return not last.dropped and not last.on_table and last.hand - last.height < 0.02


def test_the_ready_made_flow_is_valid() -> None:
    assert problems(load("lift").flow()) == []


def test_an_unknown_object_is_refused() -> None:
    with pytest.raises(ParameterError, match="lift: thing is 'anvil', must be one of box, ball"):
        lift(thing="anvil")


def test_hardware_needs_both_bus_and_gripper() -> None:
    with pytest.raises(InputError, match="needs both bus and gripper"):
        lift(gripper="10.0.0.3")
    assert [node.name for node in lift(gripper="10.0.0.3", bus=1).sinks()] == ["console", "gripper"]
    assert [node.name for node in lift().sinks()] == ["console", "hand"]


@pytest.mark.parametrize("ruled", [True, False])
def test_the_flow_holds_an_object_that_is_lost_without_it(*, ruled: bool) -> None:
    ball = named("ball")
    handling, commands, flow = SimulatedGrasp(ball, seed=3), TestSink(), Flow("lift")
    rule = grip_controller(DETECTOR, least_force(ball) / 2)
    rule = rule if ruled else Grip(force=rule.force, gain=0.0)
    _, given = declare_grip(flow, handling, load_detector(DETECTOR), rule)
    given.to(handling.hand)
    given.to(commands)
    run = _for(flow, 6)
    assert not any(status.error for status in run.sinks.values())
    assert not any(status.error for status in run.sources.values())
    assert handling.grasp is not None
    _, last = handling.grasp.sense(6.0)
    assert _is_held(last) is ruled
    assert (len(commands.rows(Commands, 0)) > 1) is ruled


async def _lifted(number: int, name: str, buses: ExitStack) -> GraspLab:
    """One lift over the devices' protocols: I2C bytes in, Modbus requests out."""
    from tests.connectors.emulators.i2c_device import served  # noqa: PLC0415 - needs smbus2

    thing = named(name)
    now = loop_clock()
    lab = await asyncio.to_thread(lambda: GraspLab(open_grasp(thing, number, UP), now))
    path = f"/dev/i2c-{70 + number}"
    server = GripperServer(Mechanism(lab, lab.now(), activation=0.2, scale=SMALL), port=0, now=lab.now)
    rule = grip_controller(DETECTOR, 0.6 * least_force(thing), settle=round(1.5 * s))
    buses.enter_context(served(FaultyI2cBus(lab, now=lab.now), path))
    async with server:
        flow = Flow("lift")
        hand = Gripper(server.host, server.port, limits=(0.05, 10.0), scale=SMALL)
        _, commands = declare_grip(flow, TakkTile(bus=path), load_detector(DETECTOR), rule)
        commands.to(hand)
        run = await LiveRunner(flow, "lift", duration=SECONDS * s).execute()
    assert not any(status.error for status in run.sinks.values())
    return lab


def _together(names: Sequence[str]) -> dict[str, GraspLab]:
    async def main() -> list[GraspLab]:
        with ExitStack() as buses:  # closed in the reverse order
            return await asyncio.gather(*(_lifted(number, name, buses) for number, name in enumerate(names)))

    return dict(zip(names, run_lab(main()), strict=True))


def _check(labs: dict[str, GraspLab]) -> None:
    for name, lab in labs.items():
        weak = [held for held in lab.states if held.force and held.instant < UP.instant]
        assert 0.4 < weak[-1].force / least_force(named(name)) < 0.8, name  # too weak, as the lift begins
        assert _is_held(lab.states[-1]), name


def test_over_i2c_and_modbus_the_ball_and_the_box_are_lifted_and_held() -> None:
    pytest.importorskip("pymodbus")
    _check(_together(["ball", "box"]))


@pytest.mark.slow
def test_over_i2c_and_modbus_every_object_is_lifted_and_held() -> None:
    pytest.importorskip("pymodbus")
    _check(_together(list(OBJECTS)))
