"""Hold what slips: feel slip, and command the grip force that stops it."""

from typing import Final

from connectors import Console, Gripper, TakkTile
from connectors.gripper.grip_force import ForceScale
from connectors.sim.grasp import least_force
from connectors.sim.grasp_source import Handling
from connectors.sim.objects import OBJECTS, named
from flows.graph import Flow, Stream
from flows.graph.quantity import Force
from operators import Commands, Debounce, Grip, Score, Scores, Sink, Source, Touch, Zero, ms, s
from operators.detectors import Detector
from operators.errors import InputError, ParameterError
from operators.grip import GripController
from storage import load_debounce, load_detector

WEAKEST: Final = ForceScale().weakest  # N, of a Robotiq 3-finger gripper
CLOSES: Final = 300 * ms  # ns; simulated fingers are there at once
COMES: Final = 2 * s  # ns; real ones close in 1.4 s


def lift(  # noqa: PLR0917 - a flow's parameters are given by name
    detector: str = "tcn_grasp",
    thing: str = "ball",
    force: Force = 0.0,
    most: Force = 10.0,
    bus: int | None = None,
    gripper: str | None = None,
    seed: int = 0,
) -> Flow:
    """Grip with `force` at first, feel slip, and grip harder, never above `most`.

    Without hardware it is an object of the simulated scene, `thing`, which is lifted after 3 s; where no
    force is given it is half of what would hold it. With hardware, `bus` is the I2C bus of a fingertip and
    `gripper` the address of a Robotiq 3-finger gripper, which cannot grip with less than 15 N; somebody else
    moves the arm. The hand must be open for the first second.

    Raises:
        InputError: if only one of bus and gripper is given.
        ParameterError: on a value that cannot be used.
    """
    flow = Flow("lift")
    source: Source[Touch]
    hand: Sink[Commands]
    if (bus is None) != (gripper is None):
        raise InputError(
            "lift", "takes a bus and a gripper, or neither: give both, as bus=1 gripper=10.0.0.3"
        )
    if bus is not None and gripper is not None:
        source, hand = TakkTile(bus=bus), Gripper(gripper, limits=(WEAKEST, max(most, WEAKEST)))
        rule = controller(detector, force or WEAKEST, most, COMES)
    else:
        if thing not in OBJECTS:
            raise ParameterError("lift", "thing", thing, f"one of {', '.join(OBJECTS)}")
        held = Handling(named(thing), seed)
        source, hand = held.touch, held.hand
        rule = controller(detector, force or least_force(held.held) / 2, most)
    scores, commands = held_by(flow, source, load_detector(detector), rule)
    (scores | (load_debounce(detector) or Debounce())).to(Console())
    commands.to(hand)
    return flow


def controller(detector: str, force: float, most: float = 10.0, settle: int = CLOSES) -> Grip:
    """Our rule, with the threshold that the detector's card names; `settle` ns for the hand to close in."""
    card = load_debounce(detector) or Debounce()
    return Grip(force=force, most=max(most, force), threshold=card.threshold, settle=settle)


def held_by(
    flow: Flow, source: Source[Touch], detector: Detector, grip: GripController, scans: int = 100
) -> tuple[Stream[Scores], Stream[Commands]]:
    """Declare how a fingertip's touch comes to grip commands: what it scores, what it commands.

    The first `scans` scans are those of an open hand.
    """
    touch = flow.source(source)
    scores = touch | Zero(scans=scans) | Score(detector)
    return scores, scores | grip
