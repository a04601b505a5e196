"""Derive samples and slips anew from recordings: for an archive, when a label or a detector has changed."""

from connectors import SimulatedRig
from flows.graph import Flow
from flows.graph.quantity import Duration, Speed
from flows.record import ARM_LATENCY
from operators import Align, Debounce, Label, Score, Zero, ms
from storage import Dataset, load_debounce, load_detector


def relabel(
    out: str = "relabelled", detector: str = "tcn", speed: Speed = 0.003, delay: Duration = ARM_LATENCY
) -> Flow:
    """Label and score recordings into `out`: run it with --replay.

    A sample slips where the arm is faster than `speed`; the arm tells of it `delay` late.
    `detector` is a built-in one or a file of weights.
    """
    flow = Flow("relabel")
    rig, dataset = SimulatedRig(), Dataset(out)  # what was recorded takes the rig's place
    touch = flow.source(rig.touch)
    motion = flow.source(rig.motion)

    zeroed = touch | Zero()
    samples = zeroed & motion | Align(within=20 * ms) | Label(speed=speed, delay=delay)
    debounce = load_debounce(detector) or Debounce(consecutive=2, release=10)
    slips = zeroed | Score(load_detector(detector)) | debounce

    samples.to(dataset)
    slips.to(dataset)
    flow.source(rig.episodes).to(dataset)  # as recorded, if they were
    flow.source(rig.truth).to(dataset)
    return flow
