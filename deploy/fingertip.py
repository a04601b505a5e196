"""Flow of one fingertip: score it, publish each slip event, and optionally record it.

The systemd unit and the container in this folder run it. Copy and change it as needed.
"""  # noqa: INP001 - runs from where it was copied to

from pathlib import Path

from connectors import Console, Mqtt, SimulatedRig, TakkTile
from flows.graph import Flow
from operators import Debounce, Faults, Health, Score, Sink, Slips, Zero, s
from storage import Dataset, identify_detector, load_debounce, load_detector


def fingertip(
    *,
    bus: int | None = 1,
    row: int = 0,
    detector: str = "tcn",
    broker: str | None = "mqtt://localhost",
    site: str = "lab",
    rig: str = "fingertip",
    out: Path | None = None,
) -> Flow:
    """Score row `row` of I2C bus `bus` (none: the simulated rig); record into `out` (none: do not record)."""
    flow = Flow("fingertip")
    touch = flow.source(SimulatedRig().touch if bus is None else TakkTile(bus, (row,)))
    debounce = load_debounce(detector) or Debounce(consecutive=2, release=10)
    slips = touch | Zero() | Score(load_detector(detector)) | debounce
    faults = touch | Health(clear_after=2 * s)

    sinks: list[Sink[Slips | Faults]] = [Console()]
    if broker:
        rules = debounce.threshold, debounce.consecutive
        sinks.append(
            Mqtt(broker, site, rig, identify_detector(detector), *rules, connect_required=False)
        )  # record even without a broker
    if out:
        dataset = Dataset(out)
        touch.to(dataset)
        sinks.append(dataset)
    for sink in sinks:
        slips.to(sink)
        faults.to(sink)
    return flow
