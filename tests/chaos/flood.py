"""Flood of rows: memory stays bounded, no row is lost, and the delay disappears."""

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
GROWTH = 250.0  # MB: the rows of two parts, each row an object, and the queue
LATE = 0.1  # s; the newest row is older
SETTLED = 2.0  # s, after the flood


def flood(scale: Scale) -> Promise:
    """Score and record touch at a hundred times its rate, one row per batch."""
    seconds, after = (3.0, 3.0) if scale.short else (60.0, 5.0)
    with scratch() as folder:
        child = start("flooded", folder / "data", f"{RATE:g}", f"{seconds:g}", f"{after:g}")
        report: Any = json.loads(finish(child, seconds + after))
        session = Session.open(folder / "data")
        rows = concat(Touch, list(session.read(Touch, 0)))
    right = alike(rows, touch(np.arange(len(rows)), rows.time)) and bool((np.diff(rows.time) > 0).all())
    lost, growth = report["produced"] - len(rows), report["most"] - report["start"]
    late = [time for time, lag in report["lags"] if time >= 0 and lag > LATE]
    settled = max(late, default=0.0) + flooded.INTERVAL
    worst = max(lag for _, lag in report["lags"])
    dropped = sum(sink["dropped"] for sink in report["sink"].values())
    return Promise(
        f"flood: {RATE:g} rows/s, one by one, for {seconds:g} s into zero, score (tcn), debounce, recorder",
        f"{lost} of {report['produced']} rows lost, {'all' if right else 'NOT all'} correct,"
        f" {dropped} dropped; {report['overrun']} overran the device's buffer; at most {worst:.2f} s late,"
        f" in real time again {settled:.2f} s after the flood; memory +{growth:.0f} MB above"
        f" {report['start']:.0f} MB",
        f"0 lost; real time within {SETTLED:g} s; <= +{GROWTH:g} MB",
        passed=not lost and right and not dropped and settled <= SETTLED and growth <= GROWTH,
    )


PROMISES = (flood,)
