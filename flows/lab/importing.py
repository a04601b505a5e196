"""Import of recordings as sessions of a dataset, for replay, training and evaluation."""

import asyncio
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from connectors import Replay, Trace
from connectors.files.column_map import COUNTS, LABEL, LABELS, ColumnMap, layout_text
from connectors.files.interpretation import Part, speeds_of
from connectors.files.raw_table import listed
from connectors.files.trace import interpreted
from flows.graph import Flow
from flows.learn.labelled_recordings import SPLITS, labelled
from flows.run.replay_runner import ReplayRunner
from flows.run.replays import session_of
from flows.run.session_output import new_session, remove_partial
from operators import Align, Label, Operator, Zero, Zeroed, ms
from operators.batch import Codes, Labelled, Motion, Touch
from operators.errors import InputError, ParameterError, SlipflowError
from operators.fingertip import TAKKTILE
from operators.label import LIMIT
from operators.ports import Description
from storage import Dataset
from storage.description import read_session
from storage.layout import SESSIONS, session_folders

_DEFAULT: Final = ColumnMap()
_LABEL: Final = Label()  # by the arm's speed; `slipflow run relabel` has other limits


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
        if isinstance(batch, Labelled):
            return replace(batch, label=label)
        touch = batch.time, batch.counts, batch.temperature, batch.valid
        unknown, unmatched = np.full((len(batch), 6), np.nan), np.zeros(len(batch), np.bool_)
        return Labelled(*touch, unknown, unknown, unmatched, unknown[:, 0], label, finger=batch.finger)


@dataclass
class TraceImport:
    """Trace as a session of a dataset; `report` shows its interpretation.

    Samples have the labels of the trace or, if it has none, labels by the arm's speed.

    Args:
        trace: The trace.
        out: Folder of the dataset; created if absent.
        session: Name of the session.
        state: ``written``; ``present`` if the dataset had it; or ``checked``: read but not written.
    """

    trace: Trace
    out: Path
    session: str
    state: str = "checked"

    @property
    def label_source(self) -> str:
        """Origin of the labels; empty if the trace has none."""
        columns = self.trace.part.columns
        return "the file" if LABEL in columns.columns else "the map" if columns.labelled else ""

    def labels(self) -> Codes:
        """Return the labels of the samples of a fingertip (n,), those of the trace or by the arm's speed."""
        part, touch = self.trace.part, self.trace.part.touch
        if self.label_source or not len(part.motion):
            return part.labels
        zeroed = Zeroed(touch.time, touch.counts, touch.temperature, touch.valid, finger=touch.finger)
        return labelled(zeroed, part.motion, _LABEL).label

    def flow(self, out: Path) -> Flow:
        """Return the flow that writes the dataset `out`."""
        flow, dataset, part = Flow("import"), Dataset(out), self.trace.part
        touch = flow.source(Replay(self.trace, Touch), "touch")
        touch.to(dataset)
        attach = AttachLabels(tuple(part.labels.tolist()))
        if len(part.motion):
            motion = flow.source(Replay(self.trace, Motion), "motion")
            motion.to(dataset)
            samples = (touch | Zero()) & motion | Align(within=20 * ms) | replace(_LABEL)
            (samples | attach if self.label_source else samples).to(dataset)
        elif self.label_source:
            (touch | Zero() | attach).to(dataset)
        return flow

    def write(self) -> None:
        """Write the session.

        Raises:
            EndpointError: if the dataset cannot be written.
            ParameterError: if the session's name is not a valid file name.
            InputError: if the dataset has another session of that name, or the folder has files but is not a
                valid dataset.
        """
        with ExitStack() as stack:
            stack.callback(remove_partial, self.out, [self.session])
            out = stack.enter_context(new_session(self.out, self.session))
            runner = ReplayRunner(self.flow(out), self.trace, self.session)
            thread = stack.enter_context(ThreadPoolExecutor(1))  # a notebook has an event loop in this one
            thread.submit(lambda: asyncio.run(runner.execute())).result()
        self.state = "written"

    def interpretation(self) -> list[str]:
        """Return a line for each quantity, with its columns and their unit."""
        part, found, lines = self.trace.part, self.trace.part.columns, list[str]()
        way = "zeroed" if found.zeroed else "raw"
        units = {**found.units, COUNTS: way if found.unit == "count" else f"{way}, {found.unit}"}
        for name, columns in found.columns.items():
            notes = [units[each] for each in [name.partition(".")[0]] if each in units]
            notes += ["recognised by name"] if name not in part.stated else []
            lines.append(f"  {name:9}{' '.join(columns)}" + (f"  ({', '.join(notes)})" if notes else ""))
        if part.fingertip is not None:
            note = "cells of each row, from the top" if found.layout else "assumed; state layout=ROWSxCOLUMNS"
            lines.append(f"  layout   {layout_text(part.fingertip.layout)}  ({note})")
        if found.range is not None:
            low, high = found.range
            way = "rise" if low < high else "fall"
            lines.append(f"  range    {low:.9g} to {high:.9g}  (readings {way} as the pressure rises)")
        else:
            takktile = found.unit == "count" and part.touch.cells == TAKKTILE.cells
            assumed = "1023 counts, falling" if takktile else "the direction of the training"
            lines.append(f"  range    unknown: detectors assume {assumed}; state range=LOW:HIGH")
        if part.unused:
            lines.append(f"  not used {listed(part.unused)}")
        return lines

    def report(self, *, short: bool = False) -> str:
        """Return the interpretation as text; `short`: without the columns."""
        part, columns = self.trace.part, self.trace.part.columns
        rows = "1 row" if len(part.touch) == 1 else f"{len(part.touch)} rows"
        rate = f"{rows}, {part.seconds:.1f} s, {columns.rate or 0.0:.1f} Hz"
        notes = f" ({', '.join(part.notes)})" if part.notes else ""
        unit = "counts" if columns.unit == "count" else columns.unit
        lowest, highest = part.extent
        lines = [f"{self.trace.name}: {rate}{notes}", *(() if short else self.interpretation())]
        lines.append(f"  readings from {lowest:.9g} to {highest:.9g} {unit}")
        if (part.resolution, unit) != (1, "counts"):
            lines.append(f"  stored in steps of {part.resolution:g} {columns.unit}")
        if len(speeds := speeds_of(part.motion)):  # (n,) m/s
            moving = f"{np.sum(speeds > _LABEL.speed)} of {len(speeds)} rows"
            moving += f", above {_LABEL.speed:g} m/s, at up to {speeds.max():.3g} m/s"
            lines.append(f"  the arm moves in {moving}")
        labels = self.labels()
        many = {name: int((labels == code).sum()) for name, code in LABELS.items()}
        counted = ", ".join(f"{count} {name}" for name, count in many.items() if count)
        if self.label_source:
            lines.append(f"  labels of {self.label_source}: {counted}")
        elif len(part.motion):
            lines.append(f"  labels by arm speed, slip above {1000 * _LABEL.speed:g} mm/s: {counted}")
        else:
            lines.append("  no labels and no motion: no samples")
        lines += [f"  warning: {each}" for each in part.warnings]
        absent = [name for name in ("slip", "static") if not many[name]]
        if absent and not self.label_source and np.any(speeds > _LABEL.speed):
            limits = f"above {_LABEL.speed:g} and below {LIMIT:g} m/s in the base's x-y plane"
            lines.append(f"  warning: no row is {absent[0]}, but the arm moves: slip is a speed {limits}")
        about = self.trace.describe()
        stated = "".join(f", {name} {about[name]}" for name in ("group", "split") if name in about)
        fingers = " and ".join(map(str, self.trace.fingers(Touch)))
        return "\n".join([*lines, f"session {self.session} of {self.out}, finger {fingers}{stated}"])


def import_frame(
    frame: Any,
    out: str | Path,
    session: str,
    columns: str | ColumnMap = _DEFAULT,
    *,
    group: str | None = None,
    about: Description | None = None,
) -> TraceImport:
    """Write a DataFrame as a session of a dataset; return its interpretation.

    Args:
        frame: A polars or pandas DataFrame, or a dictionary of arrays (n,) or (n, k).
        out: Folder of the dataset; created if absent.
        session: Name of the session.
        columns: Map of the columns, also as text.
        group: Surface or object of the recording, by which recordings are split.
        about: Further entries of the session's description.

    Raises:
        InputError: that lists all problems of the data, with a map that solves them; or if the dataset has
            another session of that name.
        ParameterError: on an invalid map or name of the session.
        EndpointError: if the dataset cannot be written.
    """
    stated = columns if isinstance(columns, ColumnMap) else ColumnMap.parse(columns)
    about = {**(about or {}), **({} if group is None else {"group": group})}
    found = TraceImport(Trace(frame, stated, name=session, about=about), Path(out), session)
    _check_rate(found.trace.part)
    found.write()
    return found


def import_files(
    paths: Sequence[Path],
    out: Path,
    columns: ColumnMap = _DEFAULT,
    *,
    group: str = "",
    split: bool = False,
    dry_run: bool = False,
) -> Iterator[tuple[Path, TraceImport | SlipflowError]]:
    """Import CSV and Parquet files one by one; those that the dataset has already are left out.

    A file that cannot be imported yields its error and does not stop the others. Files get the resolution of
    the dataset or of the first of them, so that a detector can be trained on all. An episode is a session.
    The split of a file is the name of its folder, if that is train, validation or test.

    Args:
        paths: The files.
        out: Folder of the dataset.
        columns: Map of their columns.
        group: Regular expression that is searched in the name of each file; its first group, or the whole
            match, is the surface or object.
        split: A clock that starts again begins another session.
        dry_run: Check the files and write nothing.

    Raises:
        SlipflowError: if the only file cannot be imported.
        InputError: if a file has no group, or two have the same name.
        ParameterError: on an invalid pattern, or a file as dataset.
    """
    if out.is_file():
        raise ParameterError("import", "OUT", str(out), "a folder: the last argument is the dataset to write")
    names = _session_names(paths)
    abouts = [{**_group_of(path, group), **_split_of(path)} for path in paths]
    hashes, steps = _sessions(out)
    for path, name, about in zip(paths, names, abouts, strict=True):
        try:
            parts = _parts(path, columns, steps, split=split)
            for number, part in enumerate(parts, 1):
                ending = f"-{number}" if len(parts) > 1 else ""
                found = TraceImport(Trace(part, name=str(path), about=about), out, f"{name}{ending}")
                same = [each for each, sha256 in hashes.items() if sha256 == part.sha256]
                if present := next((each for each in same if each.endswith(ending)), None):
                    found.session, found.state = present, "present"
                elif found.session in hashes:
                    reason = f"already has a session {found.session!r} of another file: rename the file"
                    raise InputError(str(out), reason)
                elif not dry_run:
                    found.write()
                hashes[found.session] = part.sha256
                yield path, found
        except SlipflowError as error:
            if len(paths) == 1:
                raise
            yield path, error


def _parts(path: Path, columns: ColumnMap, steps: dict[str, float], *, split: bool) -> list[Part]:
    """Return the parts of a file; `steps` has the resolution of earlier files by unit, and gets its own."""
    if path.is_dir():
        raise InputError(str(path), f"is a folder: give {path}/*.csv")
    found = interpreted(path, replace(columns, steps=steps), split=split)
    _check_rate(found[0])
    if columns.resolution is None:
        steps.setdefault(found[0].columns.unit, found[0].resolution)
    return found


def _check_rate(part: Part) -> None:
    """Require that the rate of a recording is known."""
    if part.fingertip is None:
        raise InputError(part.file, "has no two times, which tell the rate; state rate=... (rows per second)")


def _sessions(out: Path) -> tuple[dict[str, str], dict[str, float]]:
    """Return the sha256 of the files of a dataset's sessions, by name, and its resolution by unit."""
    hashes, steps = dict[str, str](), dict[str, float]()
    for folder in session_folders(out) if (out / SESSIONS).is_dir() else ():
        try:
            about: Any = read_session(folder)
        except InputError:  # damaged: only its name counts
            about = {}
        hashes[folder.name] = str(((about.get("sources") or {}).get("touch") or {}).get("sha256", ""))
        if tip := (about.get("fingertips") or {}).get("touch"):
            steps.setdefault(str(tip["unit"]), float(tip["resolution"]))
    return hashes, steps


def _session_names(paths: Sequence[Path]) -> list[str]:
    """Return a session name for each file; files of the same name get that of their folder too."""
    often = Counter(map(session_of, paths))
    names, seen = list[str](), dict[str, Path]()
    for path in paths:
        alike = often[session_of(path)] > 1
        names.append(session_of(Path(f"{path.parent.name}-{path.name}") if alike else path))
        if (other := seen.setdefault(names[-1].casefold(), path)) is not path:
            raise InputError(str(path), f"has the same session name as {other}: {names[-1]}; rename one")
    return names


def _split_of(path: Path) -> Description:
    """Return the split that the folder of a file states as an entry of its description."""
    folder = path.absolute().parent.name
    return {"split": folder} if folder in SPLITS else {}


def _group_of(path: Path, pattern: str) -> Description:
    """Return the surface or object that a file's name states as an entry of its description."""
    if not pattern:
        return {}
    try:
        match = re.search(pattern, path.name)
    except re.error as error:
        raise ParameterError("import", "--group", pattern, f"a regular expression: {error}") from None
    if group := match and match[min(1, match.re.groups)]:
        return {"group": group}
    raise InputError(str(path), f"has no group: its name does not match --group {pattern!r}")
