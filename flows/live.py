"""Live slip detection: score a fingertip, print slip events and faults, and publish them to a broker."""

from connectors import Console, Mqtt, SimulatedRig
from flows.graph import Flow
from flows.graph.quantity import Rate
from operators import Faults, Health, Score, Sink, Slips, Zero, s
from storage import identify_detector, load_debounce, load_detector


def live(
    detector: str = "tcn",
    broker: str | None = None,
    site: str = "lab",
    rig: str = "",
    seed: int = 0,
    *,
    false_alarms: Rate | None = None,
) -> Flow:
    """Detect slip on the simulated fingertip, and publish events if a broker is given.

    Args:
        detector: Name or weights file; tcn is for surfaces that the fingertip slides over and held objects.
        broker: Broker URL, such as mqtt://localhost; None: print only.
        site: Site name used in topics.
        rig: Rig name used in topics; empty: name of this host.
        seed: Random seed of the simulation.
        false_alarms: Rate of false alarms that the detector was calibrated for; None: as trained.
    """
    flow = Flow("live")
    touch = flow.source(SimulatedRig(seed=seed).touch)
    debounce = load_debounce(detector, false_alarms)
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
