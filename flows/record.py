"""Record synchronized, labelled samples of a fingertip dragged by an arm."""

from connectors import Rig
from flows.graph import Flow
from operators import Align, Label, Zero, ms
from storage import Dataset


def record(out: str = "recordings", seed: int = 0, speed: float = 0.003) -> Flow:
    """Record into `out`; a sample slips where the arm is faster than `speed` (m/s)."""
    rig = Rig(seed=seed)
    flow = Flow("record")
    touch = flow.source(rig.touch)
    motion = flow.source(rig.motion)
    samples = (touch | Zero()) & motion | Align(within=20 * ms) | Label(speed=speed)

    dataset = Dataset(out)
    touch.to(dataset)
    motion.to(dataset)
    samples.to(dataset)
    return flow
