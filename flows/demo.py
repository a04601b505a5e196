"""The main job with nothing attached: a simulated rig, slip events, a synchronized and labelled dataset."""

import socket
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from connectors import Console, Mqtt, SimulatedRig
from flows.graph import Flow
from flows.learn.onsets import match_onsets
from flows.record import ARM_LATENCY, declare_recording
from operators import SLIP, Debounce, Label, Run, Score, Sink, Slips, ms
from storage import Dataset, identify_detector, load_debounce, load_detector

DETECTOR: Final = "tcn"


def local_broker() -> str | None:
    """The address of an MQTT broker on this machine, if one answers."""
    try:
        socket.create_connection(("127.0.0.1", 1883), timeout=0.2).close()
    except OSError:
        return None
    return "mqtt://127.0.0.1"


class Onsets(Sink[Slips]):
    """Keeps the onsets for the summary."""

    def __init__(self) -> None:
        self.times: list[int] = []  # ns

    @property
    def destination(self) -> str:
        """The summary."""
        return "summary"

    async def open(self, run: Run) -> None:
        """Nothing to open."""

    async def write(self, batch: Slips) -> None:
        """Keep the times of onsets."""
        self.times += batch.time[batch.state == SLIP].tolist()


class Demo:
    """The demonstration's flow and what came of it."""

    def __init__(
        self,
        out: Path,
        *,
        broker: str | None,
        connect_required: bool = True,
        rig: str = "demo",
        outbox: Path | None = None,
        seed: int = 0,
    ) -> None:
        """Record into `out`; publish as `rig` to `broker` (a URL) if there is one, through `outbox`.

        With ``connect_required=False`` it starts even if the broker is unavailable.
        """
        self.out, self.broker = out, broker
        self.rig = SimulatedRig(seed=seed)
        self.onsets = Onsets()
        self.flow = Flow("demo")
        dataset = Dataset(str(out))
        zeroed = declare_recording(self.flow, self.rig, Label(speed=0.003, delay=ARM_LATENCY), dataset)
        debounce = load_debounce(DETECTOR) or Debounce()
        slips = zeroed | Score(load_detector(DETECTOR)) | debounce
        slips.to(dataset)
        slips.to(Console())
        slips.to(self.onsets)
        if broker:
            slips.to(
                Mqtt(
                    broker,
                    "lab",
                    rig,
                    outbox=outbox,
                    model=identify_detector(DETECTOR),
                    threshold=debounce.threshold,
                    consecutive=debounce.consecutive,
                    connect_required=connect_required,
                )
            )

    def summary(self, run: Run) -> dict[str, Any]:
        """What was recorded and felt, against what the simulation knows."""
        found = match_onsets(np.array(self.onsets.times, np.int64), self._slips(run))
        delays = found.delays / ms  # (caught,) ms
        return {
            "samples": run.sources["touch"].rows,
            "recorded": run.sinks["dataset"].rows,
            "slips": len(self.onsets.times),
            "true_slips": len(found.delays) + found.missed,
            "missed": found.missed,
            "false": found.false,
            "onset_ms": {
                "median": float(np.median(delays)) if len(delays) else None,
                "p90": float(np.quantile(delays, 0.9)) if len(delays) else None,
            },
            "dataset": str(self.out),
            "broker": self.broker,
        }

    def report(self, run: Run) -> str:
        """The summary for a person."""
        found = self.summary(run)
        delay, seconds = found["onset_ms"], (run.clock.now() - run.start) / 1e9
        rows = ", ".join(f"{source.rows} {name}" for name, source in run.sources.items())
        caught = found["true_slips"] - found["missed"]
        lines = [
            f"{seconds:.1f} s: {rows} samples in, {found['recorded']} rows recorded",
            f"{found['true_slips']} true slips: {caught} caught, {found['missed']} missed",
            f"{found['slips']} onsets raised, {found['false']} of them false",
        ]
        if caught:
            lines.append(f"onset delay: median {delay['median']:.0f} ms, p90 {delay['p90']:.0f} ms")
        if self.broker:
            lines.append(
                f"events go to {self.broker}; to see them as they come: slipflow watch {self.broker}"
            )
        session = self.out / "sessions" / run.session
        python = Path(sys.executable)
        lines += [
            f"dataset in {self.out}; look at it, or open it in Python, with",
            f"  {python.parent}/slipflow show {session}",
            f"  {python} -c \"import polars; print(polars.read_parquet('{session}/samples/*.parquet'))\"",
        ]
        return "\n".join(lines)

    def _slips(self, run: Run) -> list[tuple[int, int]]:
        """True sliding that the run could have felt."""
        slips = self.rig.truth().slips
        return [(start, end) for start, end in slips if start < run.sources["touch"].newest]
