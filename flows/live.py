"""Feel slip as it happens: score a fingertip, print each slip event, publish it if a broker is given."""

from connectors import Console, Mqtt, SimulatedRig
from flows.graph import Flow
from operators import Debounce, Faults, Health, Score, Sink, Slips, Zero, s
from storage import identify_detector, load_debounce, load_detector


def live(
    detector: str = "tcn", broker: str | None = None, site: str = "lab", rig: str = "rig", seed: int = 0
) -> Flow:
    """Score with `detector`, a built-in one or a file of weights; publish to `broker`, as mqtt://localhost."""
    flow = Flow("live")
    touch = flow.source(SimulatedRig(seed=seed).touch)
    debounce = load_debounce(detector) or Debounce(consecutive=2, release=10)
    slips = touch | Zero() | Score(load_detector(detector)) | debounce

    faults = touch | Health(clear_after=2 * s)

    sinks: list[Sink[Slips | Faults]] = [Console()]
    if broker:
        rules = debounce.threshold, debounce.consecutive
        sinks.append(Mqtt(broker, site, rig, identify_detector(detector), *rules))
    for sink in sinks:
        slips.to(sink)
        faults.to(sink)
    return flow
