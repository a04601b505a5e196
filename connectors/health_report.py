"""How a run is doing, as it is reported while it lasts."""

from dataclasses import asdict
from typing import Final

from operators.batch import Clocks, ms, s
from operators.ports import Json, Run

_STEPS: Final = 10  # of the host's clock, the newest, that a report tells of


class HealthReports:
    """Reports of one run.

    Rates are those since the report before, and not known in the first that tells of rows: nothing says when
    these began to come.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self._time, self._rows = run.start, dict.fromkeys(run.sources, 0)

    def next(self) -> dict[str, Json]:
        """Report the present state.

        A source is up, stale (up, but it gave nothing since the report before) or down.
        """
        run, now = self._run, self._run.clock.now()
        elapsed = (now - self._time) / s
        sources: dict[str, Json] = {}
        for name, source in run.sources.items():
            before = self._rows.get(name, 0)
            rows, known = source.rows - before, before > 0 and elapsed > 0
            sources[name] = {
                "state": ("up" if rows else "stale") if source.up else "down",
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
            "clock_steps": [asdict(step) for step in run.clock_steps[-_STEPS:]],
        }


def clock_report(clocks: Clocks) -> dict[str, Json]:
    """How a device's clock stood to the host's, as the newest row (there is one at least) tells.

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
