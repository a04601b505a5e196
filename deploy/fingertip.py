"""Slip detection on the machine of a fingertip: publish slip events, and record them on request.

The systemd unit and the container in this folder run this file. Copy and adapt it.
"""  # noqa: INP001 - not a package: it is copied

from pathlib import Path

from connectors import Console, Mqtt, SimulatedRig, TakkTile
from flows.graph import Flow
from flows.graph.quantity import Rate
from operators import Faults, Health, Score, Sink, Slips, Zero, s
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
    false_alarms: Rate | None = None,
) -> Flow:
    """Detect slip on one fingertip.

    Args:
        bus: I2C bus; None: simulated rig.
        row: Row of the fingertip on the bus.
        detector: Name or weights file; tcn is for surfaces that the fingertip slides over and held objects.
        broker: Broker URL; None: print only. The run starts even if the broker is down.
        site: Site name used in topics.
        rig: Rig name used in topics.
        out: Folder of a dataset to record into; None: do not record.
        false_alarms: Rate of false alarms that the detector was calibrated for; None: as trained.
    """
    flow = Flow("fingertip")
    touch = flow.source(SimulatedRig().touch if bus is None else TakkTile(bus, (row,)))
    debounce = load_debounce(detector, false_alarms)
    slips = touch | Zero() | Score(load_detector(detector)) | debounce
    faults = touch | Health(clear_after=2 * s)

    sinks: list[Sink[Slips | Faults]] = [Console()]
    if broker:
        rules = debounce.threshold, debounce.consecutive
        sinks.append(Mqtt(broker, site, rig, identify_detector(detector), *rules, connect_required=False))
    if out:
        dataset = Dataset(out)
        touch.to(dataset)
        sinks.append(dataset)
    for sink in sinks:
        slips.to(sink)
        faults.to(sink)
    return flow
