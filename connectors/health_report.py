"""Health reports of a run: state of sources, sinks and clocks."""

from dataclasses import asdict
from typing import Final

from operators.batch import Clocks, ms, s
from operators.ports import Json, Run

_STEPS_MAX: Final = 10  # newest steps of the host clock in a report


class HealthReports:
    """Health reports of one run.

    A rate covers the time since the previous report. A source has no rate in its first report with rows.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self._time, self._rows = run.start, dict.fromkeys(run.sources, 0)

    def next(self) -> dict[str, Json]:
        """Return a report of the current state.

        A source is ``up``, ``stale`` (it has not failed, but was silent for `Source.stale_after`) or
        ``down``.
        """
        run, now = self._run, self._run.clock.now()
        elapsed = (now - self._time) / s
        sources: dict[str, Json] = {}
        for name, source in run.sources.items():
            before = self._rows.get(name, 0)
            rows, known = source.rows - before, before > 0 and elapsed > 0
            sources[name] = {
                "state": "up" if source.up else "stale" if source.stale else "down",
                "rate_hz": round(rows / elapsed, 3) if known else None,
                "lag_ms": (now - source.newest) / ms if source.newest else None,
                "rows": source.rows,
                "late": source.late,
                "gaps": len(source.gaps),
            }
        self._time, self._rows = now, {name: source.rows for name, source in run.sources.items()}
        return {
            "session": run.session,
            "time_ns": now,
            "sources": sources,
            "sinks": {
                name: {
                    "rows": sink.rows,
                    "queued": sink.queued,
                    "dropped": sink.dropped,
                    "failures": sink.failures,
                    "error": sink.error or None,
                }
                for name, sink in run.sinks.items()
            },
            "clock_steps": [asdict(step) for step in run.clock_steps[-_STEPS_MAX:]],
        }


def clock_report(clocks: Clocks) -> dict[str, Json]:
    """Return offset and drift of the device clock from the newest row of `clocks`, which must not be empty.

    >>> import numpy as np
    >>> clock_report(Clocks(np.array([5 * s]), np.array([3 * s]), np.array([5e-05]), np.array([0.004])))
    {'time_ns': 5000000000, 'offset_ms': 3000.0, 'drift_ppm': 50.0, 'residual_ms': 4.0}
    """
    return {
        "time_ns": clocks.time.item(-1),
        "offset_ms": clocks.offset.item(-1) / ms,
        "drift_ppm": round(clocks.drift.item(-1) * 1e6, 3),
        "residual_ms": round(clocks.residual.item(-1) * 1e3, 3),
    }
