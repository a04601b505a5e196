"""Findings about fingertips before a run: cells that answer, and the rate of the scans."""

from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from connectors.takktile.i2c_access import I2cBus
from connectors.takktile.scanner import Scan, Scanner, Schedule
from connectors.takktile.takktile_protocol import ROWS, Coefficients
from operators.batch import BAROMETERS, ms, s
from operators.ports import Finding

RATE_LEAST: Final = 0.95  # smallest measured rate, of the nominal
VALID_LEAST: Final = 0.5  # smallest share of valid samples of a cell


def answering_rows(bus: I2cBus, now: Callable[[], int]) -> list[int]:
    """Return the rows of the bus at which a cell answers; none if the bus cannot be used."""
    cells = [list[Coefficients | None]([None] * BAROMETERS) for _ in range(ROWS)]
    try:
        Scanner(Schedule(bus, range(ROWS), 3 * ms, s, {}, cells), now).close()
    except OSError:
        return []
    return [row for row, known in enumerate(cells) if any(known)]


def row_findings(
    schedule: Schedule, scans: Sequence[Scan], others: Sequence[int] | None
) -> Iterator[Finding]:
    """Yield a finding for each declared row; `others` are all rows that answer, None if not searched."""
    shares = np.mean([scan.valid for scan in scans], axis=0) if scans else None  # (fingertips, 6)
    for index, row in enumerate(schedule.rows):
        subject, known = f"{schedule.bus.path} row {row}", schedule.coefficients[index]
        silent = [cell for cell, coefficients in enumerate(known) if coefficients is None]
        weak = [] if shares is None else np.flatnonzero(shares[index] < VALID_LEAST).tolist()
        if len(silent) == BAROMETERS:
            found = f"rows {_join(others)} answer: declare them, or program the fingertip" if others else ""
            yield Finding(subject, f"does not answer; {found or 'check its power and its row'}", "bad")
        elif silent:
            text = f"cells {_join(silent)} do not answer: check their soldering and cable"
            yield Finding(subject, text, "bad")
        elif weak:
            text = f"cells {_join(weak)} give implausible values: unload the fingertip, or replace it"
            yield Finding(subject, text, "bad")
        else:
            yield Finding(subject, f"{BAROMETERS} cells answer")


def rate_finding(schedule: Schedule, scans: Sequence[Scan]) -> Finding:
    """Return the measured rate of successive scans."""
    nominal, span = s / schedule.period, scans[-1].time - scans[0].time
    rate = (len(scans) - 1) * s / span if span else 0.0
    text = f"{rate:.1f} scans per second of {nominal:g}"
    if rate >= RATE_LEAST * nominal:
        return Finding(schedule.bus.path, text)
    remedy = "use a faster bus (400 kHz), fewer fingertips on the bus or a lower rate; check the load"
    return Finding(schedule.bus.path, f"{text}: {remedy}", "bad")


def _join(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))
