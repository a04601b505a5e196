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

PACE, SECONDS = 10.0, 600.0
WARM = 240.0  # s, after which all that is bounded is full
BOUND = 1.0  # MB in an hour of the rig's time


def soak(scale: Scale) -> list[Promise]:
    """The rig's whole flow, recorded and scored, at ten times its pace."""
    if scale.short:
        return []  # there is no short version of a long run
    with scratch() as folder:
        child = start("soaked", folder / "data", f"{PACE:g}", f"{SECONDS:g}")
        told: Any = json.loads(finish(child, SECONDS))
        session = Session.open(folder / "data")
        felt = sum(len(each) for each in session.read(Touch, 0))
        moved = sum(len(each) for each in session.read(Motion, EVERY))
    return [judged(told, felt, moved)]


def judged(told: Any, felt: int, moved: int) -> Promise:  # noqa: ANN401 - JSON
    """What a run says of the promise: the slope of a straight line through what it held once it was warm."""
    memory: NDArray[np.float64] = np.array(told["memory"], np.float64)  # (n, 2)
    time, held = memory[:, 0], memory[:, 1]  # s, MB
    warm = time >= WARM
    hours = time[warm] * PACE / 3600  # (m,) of the rig
    slope = float(np.polyfit(hours, held[warm], 1)[0])
    given = told["sources"]["touch"], told["sources"]["motion"]
    dropped = sum(sink["dropped"] for sink in told["sink"].values())
    lost = sum(given) - felt - moved
    return Promise(
        f"soak: the rig's flow at {PACE:g} x its pace for {SECONDS:g} s",
        f"memory {slope:+.2f} MB in an hour of the rig ({slope * PACE:+.1f} in one of the clock), at most"
        f" {held.max():.0f} MB; {dropped} dropped, {lost} of {sum(given)} rows lost",
        f"<= {BOUND:g} MB in an hour of the rig; 0, 0",
        kept=slope <= BOUND and not dropped and not lost,
    )


PROMISES = (soak,)
