"""The rig runs for long at many times its pace: memory does not grow, and nothing is lost."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from operators import EVERY, Motion, Touch
from storage import Session
from tests.chaos.processes import finish, scratch, start
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale

PACE, SECONDS = 10.0, 12000.0  # s, of the rig's time, as all that follows
WARM = 2400.0  # s, after which all that is bounded is full
SPAN = 300.0  # s, of which the median counts: memory that is taken for a moment is given back
BOUND = 1.0  # MB in an hour
SLOW = 4.0  # times as long as PACE says, at most


def soak(scale: Scale) -> list[Promise]:
    """The rig's whole flow, recorded and scored, at ten times its pace, or as fast as the machine can."""
    if scale.short:
        return []  # there is no short version of a long run
    with scratch() as folder:
        child = start("soaked", folder / "data", f"{PACE:g}", f"{SECONDS:g}")
        told: Any = json.loads(finish(child, SLOW * SECONDS / PACE))
        session = Session.open(folder / "data")
        felt = sum(len(each) for each in session.read(Touch, 0))
        moved = sum(len(each) for each in session.read(Motion, EVERY))
    return [judged(told, felt, moved)]


def judged(told: Any, felt: int, moved: int) -> Promise:  # noqa: ANN401 - JSON
    """What a run says of the promise: the slope of a straight line through the medians once it was warm."""
    memory: NDArray[np.float64] = np.array(told["memory"], np.float64)  # (n, 2)
    time, held = memory[:, 0], memory[:, 1]  # s, MB
    spans = np.floor((time - WARM) / SPAN)  # (n,)
    usual = [float(np.median(held[spans == span])) for span in np.arange((SECONDS - WARM) // SPAN)]  # MB
    slope = float(np.polyfit(np.arange(len(usual)) * SPAN / 3600, usual, 1)[0])
    given = told["sources"]["touch"], told["sources"]["motion"]
    dropped = sum(sink["dropped"] for sink in told["sink"].values())
    lost = sum(given) - felt - moved
    return Promise(
        f"soak: {SECONDS / 60:g} minutes of the rig's flow at {PACE:g} x its pace",
        f"memory {slope:+.2f} MB in an hour of the rig, at most {held.max():.0f} MB; it took"
        f" {told['took'] / 60:.0f} minutes; {dropped} dropped, {lost} of {sum(given)} rows lost",
        f"<= {BOUND:g} MB in an hour of the rig; 0, 0",
        kept=slope <= BOUND and not dropped and not lost,
    )


PROMISES = (soak,)
