"""Summary of a demo run: recorded rows, and detected against true slips."""

import socket
import sys
from pathlib import Path
from typing import Any

import numpy as np

from connectors.sim.truth import true_slips
from flows.learn.onsets import match_onsets
from operators import SLIP, Run, Slips, Truth, concat, ms
from storage import Session


def local_broker() -> str | None:
    """Return the URL of the MQTT broker on this machine, or None if none answers."""
    try:
        socket.create_connection(("127.0.0.1", 1883), timeout=0.2).close()
    except OSError:
        return None
    return "mqtt://127.0.0.1"


def summarize(run: Run, out: Path, broker: str | None) -> dict[str, Any]:
    """Compare the slips that a demo run recorded in the dataset `out` with the simulated truth."""
    session = Session.open(out / "sessions" / run.session)
    slips = concat(Slips, list(session.read(Slips, 0)))
    onsets = slips.time[slips.state == SLIP]
    found = match_onsets(onsets, true_slips(concat(Truth, list(session.read(Truth, 0)))))
    delays = found.delays / ms  # (caught,) ms
    return {
        "samples": run.sources["touch"].rows,
        "recorded": run.sinks["dataset"].rows,
        "slips": len(onsets),
        "true_slips": len(delays) + found.missed,
        "missed": found.missed,
        "false": found.false,
        "onset_ms": {
            "median": float(np.median(delays)) if len(delays) else None,
            "p90": float(np.quantile(delays, 0.9)) if len(delays) else None,
        },
        "dataset": str(out),
        "broker": broker,
    }


def report(found: dict[str, Any], run: Run) -> str:
    """Return a summary as text."""
    delay, seconds = found["onset_ms"], (run.clock.now() - run.start) / 1e9
    rows = ", ".join(f"{run.sources[name].rows} {name}" for name in ("touch", "motion"))
    caught = found["true_slips"] - found["missed"]
    lines = [
        f"{seconds:.1f} s: {rows} samples in, {found['recorded']} rows recorded",
        f"{found['true_slips']} true slips: {caught} detected, {found['missed']} missed",
        f"{found['slips']} onsets reported, {found['false']} of them false",
    ]
    if caught:
        lines.append(f"onset delay: median {delay['median']:.0f} ms, p90 {delay['p90']:.0f} ms")
    if found["broker"]:
        lines.append(
            f"events published to {found['broker']}; to follow them: slipflow watch {found['broker']}"
        )
    session, python = Path(found["dataset"]) / "sessions" / run.session, Path(sys.executable)
    lines += [
        f"dataset: {found['dataset']}; to view it, or to open it in Python:",
        f"  {python.parent}/slipflow show {session}",
        f"  {python} -c \"import polars; print(polars.read_parquet('{session}/samples/*.parquet'))\"",
    ]
    return "\n".join(lines)
