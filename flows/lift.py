"""Grip force control: detect slip of a held object and command the force that stops it."""

from typing import Final

from connectors import Console, Gripper, TakkTile
from connectors.gripper.robotiq import WEAKEST
from flows.graph import Flow
from flows.graph.quantity import Force
from operators import Grip, Score, Zero, s
from storage import load_debounce, load_detector

SETTLE: Final = 2 * s  # ns; the fingers close in 1.4 s


def lift(
    detector: str = "tcn",
    force: Force = WEAKEST,
    max_force: Force = 2 * WEAKEST,
    bus: int = 1,
    gripper: str = "192.168.1.11",
) -> Flow:
    """Grip an object, detect slip, and raise the force until the slip stops.

    Another program moves the arm. The hand must be open during the first second. `slipflow experiment lift`
    lifts simulated objects by the same rule.

    Args:
        detector: Name of a detector or weights file.
        force: Initial force; a Robotiq 3-finger gripper has a minimum of 15 N.
        max_force: Upper limit of the force.
        bus: I2C bus of the fingertip.
        gripper: Address of the gripper; the default is that of a new one.
    """
    flow, debounce = Flow("lift"), load_debounce(detector)
    rule = Grip(force=force, max_force=max_force, threshold=debounce.threshold, settle=SETTLE)
    scores = flow.source(TakkTile(bus=bus)) | Zero() | Score(load_detector(detector))
    (scores | debounce).to(Console())
    (scores | rule).to(Gripper(gripper))
    return flow
