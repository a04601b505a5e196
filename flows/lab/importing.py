"""Import of recorded traces as sessions of a dataset, for replay, training and evaluation."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from connectors import Replay, Trace
from connectors.files.column_map import COUNTS, JOINT, LABEL, LABELS, ColumnMap
from connectors.files.pad import Pad, layout_text
from flows.graph import Flow
from flows.run.replay_runner import ReplayRunner
from operators import Align, Label, Operator, Zero, Zeroed, ms
from operators.batch import Labelled, Motion, Touch, s
from operators.errors import InputError
from operators.fingertip import RATE_TOLERANCE
from operators.ports import Run
from storage import Dataset

if TYPE_CHECKING:
    from connectors.files.trace_table import TraceTable

_DEFAULT: Final = ColumnMap()
_UNKNOWN_PAD: Final = Pad()
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9._-]+")


@dataclass
class AttachLabels(Operator[Zeroed, Labelled]):
    """Operator that attaches the labels of a file to its rows, in order.

    Samples keep their motion and speed; both are NaN for touch rows.
    """

    labels: tuple[int, ...] = field(repr=False)  # per row: 1 slip, 0 static, -1 unknown
    _next: int = field(default=0, init=False, repr=False)

    def process(self, batch: Zeroed) -> Labelled:
        """Return the labelled rows."""
        label = np.array(self.labels[self._next : self._next + len(batch)], np.int8)
        self._next += len(batch)
        unknown = np.full((len(batch), 6), np.nan)
        velocity, pose, speed, matched = unknown, unknown, unknown[:, 0], np.zeros(len(batch), np.bool_)
        if isinstance(batch, Labelled):
            velocity, pose, speed, matched = batch.velocity, batch.pose, batch.speed, batch.matched
        touch = batch.time, batch.counts, batch.temperature, batch.valid
        return Labelled(*touch, velocity, pose, matched, speed, label, finger=batch.finger)


class TraceImport:
    """Trace that was read but not written yet; `summary` and `report` show its interpretation.

    Samples have the labels of the file or, if it has none, labels by the arm's speed.

    Args:
        source: The file, or a table that was read from one (`connectors.files.formats.read_table`).
        out: Folder of the dataset; created if absent.
        columns: Map of the columns; unmapped ones are recognised by their usual names.
        rate: Rows per second, Hz: of a file without a time; otherwise the expected rate.
        finger: Number of the fingertip.
        zeroed: Readings are relative to the unloaded fingertip (default: if one is negative).
        label: Labels by the arm's speed, for a file without labels.
        session: Name of the session (default: the file's name).
        group: Surface or object of the recording, by which recordings are split.
        pad: Layout and range of the fingertip.

    Raises:
        InputError: if the file has an invalid value, named by row and column, or another rate.
        ParameterError: on an invalid parameter.
    """

    def __init__(
        self,
        source: "str | Path | TraceTable",
        out: Path,
        columns: ColumnMap = _DEFAULT,
        *,
        rate: float | None = None,
        finger: int = 0,
        zeroed: bool | None = None,
        label: Label | None = None,
        session: str | None = None,
        group: str | None = None,
        pad: Pad = _UNKNOWN_PAD,
    ) -> None:
        self.trace = Trace(source, columns, finger=finger, zeroed=zeroed, rate=rate, group=group, pad=pad)
        found = self.trace.rate
        if rate is not None and found is not None and abs(found / rate - 1) > RATE_TOLERANCE:
            reason = f"has {found:.1f} rows per second, not {rate:g}: is its time in another unit?"
            raise InputError(self.trace.name, reason)
        self.session = session or session_name(self.trace.name)
        self._out, self._columns, self._label, self._pad = out, columns, label or Label(), pad

    @property
    def label_source(self) -> str:
        """Origin of the labels; empty if there are neither labels nor motion."""
        if LABEL in self.trace.columns.columns:
            return "the file"
        if not len(self.trace.motion):
            return ""
        delay = f", {self._label.delay / ms:g} ms after the sample" if self._label.delay else ""
        return f"arm speed, slip above {1000 * self._label.speed:g} mm/s{delay}"

    def flow(self) -> Flow:
        """Return the flow that writes the dataset."""
        flow, dataset = Flow("import"), Dataset(self._out)
        touch = flow.source(Replay(self.trace, Touch), "touch")
        touch.to(dataset)
        attach = AttachLabels(tuple(self.trace.labels.tolist()))
        if len(self.trace.motion):
            motion = flow.source(Replay(self.trace, Motion), "motion")
            motion.to(dataset)
            samples = (touch | Zero()) & motion | Align(within=20 * ms) | self._label
            (samples | attach if self.label_source == "the file" else samples).to(dataset)
        elif self.label_source:
            (touch | Zero() | attach).to(dataset)
        return flow

    async def write(self, progress: Callable[[int], None] = lambda _rows: None) -> Run:
        """Write the session; `progress` is called with the number of rows written.

        Raises:
            EndpointError: if the dataset cannot be written, or has a session of that name.
            ParameterError: if the session's name is not a valid file name.
            InputError: if the folder has files but is not a valid dataset.
        """

        def report(run: Run) -> bool:
            progress(run.sources["touch"].rows)
            return False

        return await ReplayRunner(self.flow(), self.trace, self.session).execute(report)

    def summary(self) -> dict[str, Any]:
        """Return the interpretation of the file as JSON data."""
        trace = self.trace
        speeds = trace.speeds  # (n,) m/s
        lowest, highest = trace.extent
        return {
            **trace.describe(),
            "recognised": [name for name in trace.columns.columns if name not in self._columns.columns],
            "finger": trace.touch.finger,
            "seconds": int(trace.touch.time[-1] - trace.touch.time[0]) / s,
            "rate": trace.rate,
            "unit": trace.columns.cell_units[1],
            "resolution": trace.resolution,
            "lowest": lowest,
            "highest": highest,
            "missing": trace.missing,
            "motion": len(trace.motion),
            "moving": int((speeds > self._label.speed).sum()),
            "fastest": float(speeds.max()) if len(speeds) else None,
            "warnings": list(trace.warnings),
            "labelled": self.label_source or None,
            "labels": {name: int((trace.labels == code).sum()) for name, code in LABELS.items()},
            "dataset": str(self._out),
            "session": self.session,
        }

    def interpretation(self) -> list[str]:
        """Return a line for each quantity, with its columns and their unit."""
        trace, lines = self.trace, list[str]()
        units = {**trace.columns.units, COUNTS: self._cells()}
        for name, columns in trace.columns.columns.items():
            notes = [units[name]] if name in units else []
            notes += [f"times {trace.columns.lever:g} m"] if name == JOINT else []
            notes += ["recognised by name"] if name not in self._columns.columns else []
            text = f"  {name:9}{' '.join(columns)}"
            lines.append(f"{text}  ({', '.join(notes)})" if notes else text)
        if self._pad.layout is not None:
            lines.append(f"  layout   {layout_text(self._pad.layout)}  (cells of each row, from the top)")
        if self._pad.range is not None:
            low, high = self._pad.range
            way = "rise" if low < high else "fall"
            lines.append(f"  range    {low:g} to {high:g}  (readings {way} as the pressure rises)")
        if self.label_source not in ("", "the file"):
            lines.append(f"  labels by {self.label_source}")
        if not self.label_source:
            lines.append("  no labels and no motion: no samples")
        return lines

    def report(self) -> str:
        """Return the interpretation of the file as text."""
        found, trace = self.summary(), self.trace
        lines = [f"{trace.name}: {found['rows']} rows, {found['seconds']:.1f} s, {trace.rate or 0.0:.1f} Hz"]
        lines[0] += f" ({', '.join(trace.notes)})" if trace.notes else ""
        lines += [*self.interpretation(), *stored([found])]
        if found["motion"]:
            moving = f"{found['moving']} of {found['motion']} rows, above {self._label.speed:g} m/s"
            lines.append(f"  the arm moves in {moving}, at up to {found['fastest']:.3g} m/s")
        if self.label_source == "the file":
            counts = ", ".join(f"{count} {name}" for name, count in found["labels"].items() if count)
            lines.append(f"  labels of the file: {counts}")
        lines += [f"  warning: {each}" for each in found["warnings"]]
        group = "" if trace.group is None else f", group {trace.group}"
        return "\n".join([*lines, f"session {self.session} of {self._out}, finger {found['finger']}{group}"])

    def _cells(self) -> str:
        source, unit = self.trace.columns.cell_units
        converted = "" if unit == "count" else f", {unit}" if source == unit else f", {source} as {unit}"
        return ("zeroed" if self.trace.kind is Zeroed else "raw") + converted


def stored(files: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return lines on the range and the resolution of files, given their summaries.

    >>> stored([{"lowest": 95.2, "highest": 99, "resolution": 0.01, "unit": "kPa"}])
    ['  readings from 95.2 to 99 kPa', '  stored in steps of 0.01 kPa']
    """
    resolution, unit = files[0]["resolution"], files[0]["unit"]
    lowest, highest = min(each["lowest"] for each in files), max(each["highest"] for each in files)
    lines = [f"  readings from {lowest:g} to {highest:g} {'counts' if unit == 'count' else unit}"]
    exact = (resolution, unit) == (1, "count")  # stored as they are
    return lines if exact else [*lines, f"  stored in steps of {resolution:g} {unit}"]


def session_name(file: str) -> str:
    """Return the name of the session of a file.

    >>> session_name("data/lab 3, night.csv")
    'lab-3-night'
    """
    stem = Path(file.removesuffix(".gz")).stem
    return _UNSAFE.sub("-", stem).strip("-._")[:128] or "trace"
