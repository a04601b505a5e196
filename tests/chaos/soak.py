"""Long run at many times real time: memory does not grow, and no row is lost."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from operators import EVERY, Motion, Touch
from storage import Session
from tests.chaos.processes import finish, scratch, start
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale

PACE, SECONDS = 10.0, 12000.0  # times real time; s of rig time
WARM = 2400.0  # s of rig time, after which all bounded buffers are full
SPAN = 300.0  # s of rig time; the median of each span counts, so that peaks do not
BOUND = 1.0  # MB per hour of rig time
SLOW = 4.0  # largest duration relative to PACE


def soak(scale: Scale) -> list[Promise]:
    """Run, record and score the rig's flow at ten times real time, or as fast as the machine can."""
    if scale.short:
        return []  # a long run has no short version
    with scratch() as folder:
        child = start("soaked", folder / "data", f"{PACE:g}", f"{SECONDS:g}")
        report: Any = json.loads(finish(child, SLOW * SECONDS / PACE))
        session = Session.open(folder / "data")
        touch_rows = sum(len(each) for each in session.read(Touch, 0))
        motion_rows = sum(len(each) for each in session.read(Motion, EVERY))
    return [evaluate(report, touch_rows, motion_rows)]


def evaluate(report: Any, touch_rows: int, motion_rows: int) -> Promise:  # noqa: ANN401 - JSON
    """Evaluate a run by the slope of a straight line through the medians after the warm-up."""
    memory: NDArray[np.float64] = np.array(report["memory"], np.float64)  # (n, 2)
    time, resident = memory[:, 0], memory[:, 1]  # s, MB
    spans = np.floor((time - WARM) / SPAN)  # (n,)
    medians = [
        float(np.median(resident[spans == span])) for span in np.arange((SECONDS - WARM) // SPAN)
    ]  # MB
    slope = float(np.polyfit(np.arange(len(medians)) * SPAN / 3600, medians, 1)[0])
    produced = report["sources"]["touch"], report["sources"]["motion"]
    dropped = sum(sink["dropped"] for sink in report["sink"].values())
    lost = sum(produced) - touch_rows - motion_rows
    return Promise(
        f"soak: {SECONDS / 60:g} minutes of the rig's flow at {PACE:g} x real time",
        f"memory {slope:+.2f} MB per hour of rig time, at most {resident.max():.0f} MB; took"
        f" {report['duration'] / 60:.0f} minutes; {dropped} rows dropped, {lost} of {sum(produced)} lost",
        f"<= {BOUND:g} MB per hour of rig time; 0, 0",
        passed=slope <= BOUND and not dropped and not lost,
    )


PROMISES = (soak,)
