"""Far more rows come than usual: memory stays bounded, the recorder loses none, and the lag goes away."""

import json
from typing import Any

import numpy as np

from operators import Touch, concat
from storage import Session
from tests.chaos import flooded
from tests.chaos.numbered import alike, touch
from tests.chaos.processes import finish, scratch, start
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale

RATE = 10_000.0  # rows/s
MOST = 250.0  # MB more than at the start: two parts' worth of rows, each an object, and the queue
REAL = 0.1  # s, the most that the newest row is old in real time
SOON = 2.0  # s


def flood(scale: Scale) -> Promise:
    """Touch at a hundred times its rate, each row by itself, scored and recorded."""
    seconds, after = (3.0, 3.0) if scale.short else (60.0, 5.0)
    with scratch() as folder:
        child = start("flooded", folder / "data", f"{RATE:g}", f"{seconds:g}", f"{after:g}")
        told: Any = json.loads(finish(child, seconds + after))
        session = Session.open(folder / "data")
        rows = concat(Touch, list(session.read(Touch, 0)))
    right = alike(rows, touch(np.arange(len(rows)), rows.time)) and bool((np.diff(rows.time) > 0).all())
    lost, growth = told["given"] - len(rows), told["most"] - told["start"]
    back = [time for time, lag in told["lags"] if time >= 0 and lag > REAL]
    settled = max(back, default=0.0) + flooded.LOOK
    worst = max(lag for _, lag in told["lags"])
    dropped = sum(sink["dropped"] for sink in told["sink"].values())
    return Promise(
        f"flood: {RATE:g} rows/s, one by one, for {seconds:g} s into zero, score (tcn), debounce, recorder",
        f"{lost} of {told['given']} rows lost, {'all' if right else 'NOT all'} right, {dropped} dropped;"
        f" {told['overrun']} never left the device; at most {worst:.2f} s behind,"
        f" real time {settled:.2f} s after it; memory +{growth:.0f} MB, on {told['start']:.0f}",
        f"0 lost; real time within {SOON:g} s; + <= {MOST:g} MB",
        kept=not lost and right and not dropped and settled <= SOON and growth <= MOST,
    )


PROMISES = (flood,)
