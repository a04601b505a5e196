"""Recording of synchronised, labelled samples of a fingertip that an arm drags over a surface."""

from connectors import SimulatedRig
from flows.graph import Flow, Stream
from flows.graph.quantity import Duration, Speed
from operators import Align, Label, Zero, Zeroed, ms
from operators.checks import check_at_least
from storage import Dataset

ARM_LATENCY = 70 * ms  # ns, lag of the simulated arm velocity behind the touch


def record(
    out: str = "recordings", seed: int = 0, speed: Speed = 0.003, delay: Duration = ARM_LATENCY
) -> Flow:
    """Record the simulated rig and label its samples.

    Args:
        out: Folder of the dataset.
        seed: Random seed of the simulation.
        speed: Arm speed above which a sample is slip.
        delay: Lag of the arm's velocity relative to the touch.

    Raises:
        ParameterError: if the delay is below 0.
    """
    check_at_least("record", "delay", delay, 0, "ns")
    flow = Flow("record")
    declare_recording(flow, SimulatedRig(seed=seed), Label(speed=speed, delay=delay), Dataset(out))
    return flow


def declare_recording(flow: Flow, rig: SimulatedRig, label: Label, dataset: Dataset) -> Stream[Zeroed]:
    """Declare the recording of a rig's streams and of its labelled samples.

    Returns:
        Stream of zeroed touch.
    """
    touch = flow.source(rig.touch)
    motion = flow.source(rig.motion)
    zeroed = touch | Zero()
    samples = zeroed & motion | Align(within=20 * ms) | label

    touch.to(dataset)
    motion.to(dataset)
    samples.to(dataset)
    flow.source(rig.episodes).to(dataset)
    flow.source(rig.truth).to(dataset)
    return zeroed
