"""Grip force control: detect slip of a held object and command the force that stops it."""

from typing import Final

from connectors import Console, Gripper, TakkTile
from connectors.gripper.robotiq import WEAKEST
from connectors.sim.grasp import least_force
from connectors.sim.hand import Hand
from connectors.sim.objects import OBJECTS
from flows.graph import Flow
from flows.graph.quantity import Force
from operators import Commands, Debounce, Grip, Score, Sink, Source, Touch, Zero, ms, s
from operators.errors import InputError, ParameterError
from storage import load_debounce, load_detector

SIMULATED_SETTLE: Final = 300 * ms  # ns; simulated fingers close at once
REAL_SETTLE: Final = 2 * s  # ns; real fingers close in 1.4 s


def lift(
    detector: str = "tcn",
    thing: str = "ball",
    force: Force = 0.0,
    max_force: Force = 10.0,
    bus: int | None = None,
    gripper: str | None = None,
    seed: int = 0,
) -> Flow:
    """Grip an object, detect slip, and raise the force until the slip stops.

    Without hardware, a simulated object is lifted after 4.5 s. With hardware, another program moves the arm.
    A Robotiq 3-finger gripper has a minimum force of 15 N. The hand must be open during the first second.

    Args:
        detector: Name of a detector or weights file.
        thing: Simulated object.
        force: Initial force; 0: half the force that holds the simulated object, or the gripper's minimum.
        max_force: Upper limit of the force.
        bus: I2C bus of the fingertip.
        gripper: Address of the gripper.
        seed: Random seed of the simulation.

    Raises:
        InputError: if only one of `bus` and `gripper` is given.
        ParameterError: if a parameter is invalid.
    """
    flow = Flow("lift")
    source: Source[Touch]
    hand: Sink[Commands]
    if (bus is None) != (gripper is None):
        raise InputError("lift", "needs both bus and gripper, or neither: set bus=1 and gripper=10.0.0.3")
    if bus is not None and gripper is not None:
        source, hand = TakkTile(bus=bus), Gripper(gripper, limits=(WEAKEST, max(max_force, WEAKEST)))
        force, settle = force or WEAKEST, REAL_SETTLE
    else:
        if thing not in OBJECTS:
            raise ParameterError("lift", "thing", thing, f"one of {', '.join(OBJECTS)}")
        held = Hand(OBJECTS[thing], seed)
        source, hand = held.touch, held
        force, settle = force or least_force(held.held) / 2, SIMULATED_SETTLE
    debounce = load_debounce(detector) or Debounce()
    rule = Grip(force=force, max_force=max(max_force, force), threshold=debounce.threshold, settle=settle)
    scores = flow.source(source) | Zero() | Score(load_detector(detector))
    (scores | debounce).to(Console())
    (scores | rule).to(hand)
    return flow
