"""CSV traces as sessions of a dataset, which replay, train and are judged like recorded ones."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from connectors import CsvTrace, Replay
from connectors.files.csv_columns import LABEL, ColumnMap
from connectors.files.csv_trace import OFF
from flows.graph import Flow
from flows.graph.drawing import describe
from flows.run.replay_runner import ReplayRunner
from operators import Align, Label, Operator, Zero, Zeroed, ms
from operators.batch import SLIP, STATIC, UNKNOWN, Labelled, Motion, Touch, s
from operators.errors import InputError
from operators.ports import Run
from storage import Dataset

_STRANGE: Final = re.compile(r"[^A-Za-z0-9._-]+")
_LABELS: Final = {"slip": SLIP, "static": STATIC, "unknown": UNKNOWN}


@dataclass
class Told(Operator[Zeroed, Labelled]):
    """Give each row the next of the labels that a file tells.

    Samples keep their motion and speed; touches, which have none, get NaN.
    """

    labels: tuple[int, ...] = field(repr=False)  # of the file's rows: 1 slip, 0 static, -1 unknown
    _next: int = field(default=0, init=False, repr=False)

    def process(self, batch: Zeroed) -> Labelled:
        """Label the rows."""
        label = np.array(self.labels[self._next : self._next + len(batch)], np.int8)
        self._next += len(batch)
        unknown = np.full((len(batch), 6), np.nan)
        velocity, pose, speed, matched = unknown, unknown, unknown[:, 0], np.zeros(len(batch), np.bool_)
        if isinstance(batch, Labelled):
            velocity, pose, speed, matched = batch.velocity, batch.pose, batch.speed, batch.matched
        touch = batch.time, batch.counts, batch.temperature, batch.valid
        return Labelled(*touch, velocity, pose, matched, speed, label, finger=batch.finger)


class Import:
    """A CSV trace, understood but not yet written: `summary` and `report` say what would become of it.

    Samples get the labels of the file or, where it has none, those that the arm's speed tells.

    Args:
        path: the file.
        out: the dataset's folder; made if absent.
        columns: which columns hold what; what it leaves out is guessed where the names are usual.
        rate: rows per second: of a file that tells no time; of another, what is to be expected.
        finger: the fingertip that the trace is of.
        zeroed: whether the counts are relative to the unloaded fingertip; None: they are if one is negative.
        label: how the arm's speed tells slip, where the file has no labels.
        session: what to call the session; None: by the name of the file.

    Raises:
        InputError: naming line and column, if the file cannot be used, or comes at another rate.
        ParameterError: on a parameter that cannot be.
    """

    def __init__(
        self,
        path: Path,
        out: Path,
        columns: ColumnMap,
        *,
        rate: float | None = None,
        finger: int = 0,
        zeroed: bool | None = None,
        label: Label | None = None,
        session: str | None = None,
    ) -> None:
        self.trace = CsvTrace(path, columns, finger=finger, zeroed=zeroed, rate=rate)
        found = self.trace.rate
        if rate is not None and found is not None and abs(found / rate - 1) > OFF:
            reason = (
                f"comes at {found:.1f} rows per second, not at {rate:g}; is the unit of its time another?"
            )
            raise InputError(str(path), reason)
        self.session = session or _STRANGE.sub("-", path.stem).strip("-._")[:128] or "trace"
        self._out, self._columns, self._label = out, columns, label or Label()

    @property
    def labelled(self) -> str:
        """What the labels come from; empty: there are none, and so no samples."""
        if LABEL in self.trace.columns.columns:
            return "the file"
        return describe(self._label) if len(self.trace.motion) else ""

    def flow(self) -> Flow:
        """How the file comes into the dataset."""
        flow, dataset = Flow("import"), Dataset(self._out)
        touch = flow.source(Replay(self.trace, Touch, pace=None), "touch")
        touch.to(dataset)
        told = Told(tuple(self.trace.labels.tolist()))
        if len(self.trace.motion):
            motion = flow.source(Replay(self.trace, Motion, pace=None), "motion")
            motion.to(dataset)
            samples = (touch | Zero()) & motion | Align(within=20 * ms) | self._label
            (samples | told if self.labelled == "the file" else samples).to(dataset)
        elif self.labelled:
            (touch | Zero() | told).to(dataset)
        return flow

    async def write(self, progress: Callable[[int], None] = lambda _rows: None) -> Run:
        """Write the session; `progress` is told how many rows of touch are done.

        Raises:
            EndpointError: if the dataset cannot be written to, or has a session of that name.
            ParameterError: if the session's name is no file name.
            InputError: if the folder holds files and is no dataset, or its description is not as it must be.
        """
        runner = ReplayRunner(self.flow(), self.trace, self.session)
        return await runner.execute(lambda run: progress(run.sources["touch"].rows))

    def summary(self) -> dict[str, Any]:
        """What was understood, for a program."""
        trace = self.trace
        speeds = trace.speeds  # (n,) m/s
        return {
            **trace.describe(),
            "guessed": [name for name in trace.columns.columns if name not in self._columns.columns],
            "finger": trace.touch.finger,
            "seconds": int(trace.touch.time[-1] - trace.touch.time[0]) / s,
            "rate": trace.rate,
            "motion": len(trace.motion),
            "moving": int((speeds > self._label.speed).sum()),
            "fastest": float(speeds.max()) if len(speeds) else None,
            "doubts": list(trace.doubts),
            "labelled": self.labelled or None,
            "labels": {name: int((trace.labels == code).sum()) for name, code in _LABELS.items()},
            "dataset": str(self._out),
            "session": self.session,
        }

    def report(self) -> str:
        """The same for a person."""
        found, rate = self.summary(), self.trace.rate or 0.0
        lines = [f"{self.trace.name}: {found['rows']} rows, {found['seconds']:.1f} s, {rate:.1f} Hz"]
        units = {**found["units"], "counts": "zeroed" if found["zeroed"] else "raw"}
        for name, columns in found["columns"].items():
            notes = [units[name]] if name in units else []
            notes += ["guessed from the names"] if name in found["guessed"] else []
            lines.append(f"  {name:9}{' '.join(columns)}  ({', '.join(notes)})".removesuffix("  ()"))
        if found["motion"]:
            moving = f"{found['moving']} of {found['motion']} rows, above {self._label.speed:g} m/s"
            lines.append(f"  the arm moves in {moving}, at up to {found['fastest']:.3g} m/s")
        counts = ", ".join(f"{count} {name}" for name, count in found["labels"].items() if count)
        by_file = f"  labels of the file: {counts}"
        by_speed = (
            f"  labels by {self.labelled}" if self.labelled else "  no labels and no motion: no samples"
        )
        lines.append(by_file if self.labelled == "the file" else by_speed)
        lines += [f"  doubtful: {each}" for each in found["doubts"]]
        return "\n".join([*lines, f"session {self.session} of {self._out}, finger {found['finger']}"])
