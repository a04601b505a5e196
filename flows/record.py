"""Record synchronized, labelled samples of a fingertip dragged by an arm."""

from connectors import SimulatedRig
from flows.graph import Flow, Stream
from flows.graph.quantity import Duration, Speed
from operators import Align, Label, Zero, Zeroed, ms
from storage import Dataset

ARM_LATENCY = 70 * ms  # how much later than the barometers the simulated arm tells of the same instant


def record(
    out: str = "recordings", seed: int = 0, speed: Speed = 0.003, delay: Duration = ARM_LATENCY
) -> Flow:
    """Record into `out`; a sample slips where the arm is faster than `speed`.

    The simulated arm tells of its motion `delay` after the barometers felt it.
    """
    flow = Flow("record")
    declare_recording(flow, SimulatedRig(seed=seed), Label(speed=speed, delay=delay), Dataset(out))
    return flow


def declare_recording(flow: Flow, rig: SimulatedRig, label: Label, dataset: Dataset) -> Stream[Zeroed]:
    """Declare how the streams of a rig, and the samples labelled from them, come into a dataset.

    Returns:
        The zeroed touch, for what else is to be made of it.
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
