"""Demonstration without hardware: a simulated rig, slip events, and a synchronised, labelled dataset."""

from connectors import Console, Mqtt, SimulatedRig
from flows.graph import Flow
from flows.record import ARM_LATENCY, declare_recording
from operators import Label, Score
from storage import Dataset, identify_detector, load_debounce, load_detector


def demo(out: str = "recordings", broker: str | None = None) -> Flow:
    """Record a simulated fingertip and arm into `out`, detect slip, and publish the events to `broker`.

    Args:
        out: Folder of the dataset.
        broker: Broker URL, such as mqtt://localhost; None: publish nothing.
    """
    flow, dataset = Flow("demo"), Dataset(out)
    zeroed = declare_recording(flow, SimulatedRig(), Label(speed=0.003, delay=ARM_LATENCY), dataset)
    debounce = load_debounce("tcn")
    slips = zeroed | Score(load_detector("tcn")) | debounce

    slips.to(dataset)
    slips.to(Console())
    if broker:
        rules = debounce.threshold, debounce.consecutive
        slips.to(Mqtt(broker, "lab", "demo", identify_detector("tcn"), *rules))
    return flow
