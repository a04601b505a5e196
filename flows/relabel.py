"""Relabelling: new samples and slips from recordings, after a change of labels or detector."""

from connectors import SimulatedRig
from connectors.ur.ur_state import Pose
from flows.graph import Flow
from flows.graph.quantity import Duration, Rate, Speed
from flows.record import ARM_LATENCY
from operators import Align, Label, MaskLifted, Score, Zero, ms
from operators.errors import ParameterError
from storage import Dataset, load_debounce, load_detector


def relabel(
    out: str = "relabelled",
    detector: str = "tcn",
    speed: Speed = 0.003,
    delay: Duration = ARM_LATENCY,
    false_alarms: Rate | None = None,
    surface: str = "",
) -> Flow:
    """Label and score recordings again; run it with --replay.

    Args:
        out: Folder of the new dataset.
        detector: Name or weights file; tcn is for surfaces that the fingertip slides over and held objects.
        speed: Arm speed above which a sample is slip.
        delay: Lag of the arm's velocity relative to the touch.
        false_alarms: Rate of false alarms that the detector was calibrated for; None: as trained.
        surface: Pose at contact, as `place` in session.json of a collection: 0,0,0,3.14,0,0 (m and rotation
            vector). Slip labels more than 2 mm above it become unknown. Empty: they stay.

    Raises:
        ParameterError: if the surface is no pose.
    """
    flow = Flow("relabel")
    rig, dataset = SimulatedRig(), Dataset(out)  # --replay replaces the rig by the recording
    touch = flow.source(rig.touch)
    motion = flow.source(rig.motion)

    zeroed = touch | Zero()
    samples = zeroed & motion | Align(within=20 * ms) | Label(speed=speed, delay=delay)
    if surface:
        samples |= MaskLifted(_pose(surface))
    debounce = load_debounce(detector, false_alarms)
    slips = zeroed | Score(load_detector(detector)) | debounce

    samples.to(dataset)
    slips.to(dataset)
    flow.source(rig.episodes).to(dataset)  # copied, if recorded
    flow.source(rig.truth).to(dataset)
    return flow


def _pose(text: str) -> Pose:
    try:
        x, y, z, a, b, c = map(float, text.split(","))
    except ValueError:
        must_be = "six numbers with commas: position (m) and rotation vector (rad)"
        raise ParameterError("relabel", "surface", text, must_be) from None
    return x, y, z, a, b, c
