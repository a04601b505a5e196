"""Feel slip as it happens: score a fingertip, print each slip event, publish it if a broker is given."""

from connectors import Console, Mqtt, Rig
from flows.graph import Flow
from operators import Debounce, Health, Score, Zero
from storage import load_debounce, load_detector


def live(
    detector: str = "tcn", broker: str | None = None, site: str = "lab", rig: str = "rig", seed: int = 0
) -> Flow:
    """Score with `detector`, a built-in one or a file of weights; publish to `broker`, as mqtt://localhost."""
    flow = Flow("live")
    touch = flow.source(Rig(seed=seed).touch)
    debounce = load_debounce(detector) or Debounce(consecutive=2, release=10)
    slips = touch | Zero() | Score(load_detector(detector)) | debounce

    faults = touch | Health()

    for sink in (Console(), *([Mqtt(broker, site=site, rig=rig)] if broker else [])):
        slips.to(sink)
        faults.to(sink)
    return flow
