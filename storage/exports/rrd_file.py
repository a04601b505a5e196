"""Export of a session to one Rerun recording (.rrd): streams as time series, events as a text log."""

import json
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np

from operators.batch import (
    SLIP,
    AnyBatch,
    Batch,
    Faults,
    Labelled,
    Motion,
    Scores,
    Slips,
    Touch,
)
from operators.detectors import Detector
from operators.errors import EndpointError
from operators.extras import require_extra
from operators.health import FaultKind
from operators.score import Score
from operators.zero import Zero
from storage.files import partial_file
from storage.session import Session

TIMELINE: Final = "time"  # event time, since 1970 UTC


def export(
    session: Session,
    path: Path,
    detector: Detector | None = None,
    progress: Callable[[int], object] = lambda _rows: None,
) -> Mapping[str, int]:
    """Write a session; return the number of rows of each entity.

    - ``/touch/FINGER``: counts of each cell, raw or zeroed as recorded; gaps where it has no reading
    - ``/probability/FINGER``: slip probability by `detector`; raw touch is zeroed first
    - ``/motion/speed``: speed of the tool centre point, m/s; ``/samples/FINGER/speed``: in the contact plane
    - ``/slip/FINGER``: onsets and ends as lines of text; ``/faults``: faults of barometers
    - ``/session``: contents of session.json; ``/hand_labels``: labels given by hand, if there are any

    Streams are read and written part by part, so memory does not grow with the session.

    Args:
        session: Session to write.
        path: File to create.
        detector: Detector to score with; None: no probability.
        progress: Called with the number of rows written so far.

    Raises:
        InputError: if the library is not installed, or the session is damaged.
        EndpointError: if the file exists or cannot be written; then nothing is left of it.
    """
    require_extra("rerun", "Rerun export")
    counts = Counter[str]()
    with partial_file(path) as file:
        with closing(_Recording(session.name, file.name)) as recording:
            for entity, rows in recording.send(session, detector):
                counts[entity] += rows
                progress(counts.total())
        check_complete(file.name, path)
    return dict(counts)


class _Recording:
    """File that the Rerun library writes."""

    def __init__(self, name: str, path: str) -> None:
        self._rerun: Any = import_module("rerun")  # an extra, and slow to import
        self._stream: Any = self._rerun.RecordingStream("slipflow", recording_id=name)
        self._stream.save(path)
        self._named = set[str]()  # entities with series names

    def close(self) -> None:
        """Complete the file."""
        self._stream.disconnect()

    def send(self, session: Session, detector: Detector | None) -> Iterator[tuple[str, int]]:
        """Write a session; yield the entity and number of rows of each batch."""
        about = json.dumps(dict(session.about), indent=1, default=str)
        self._stream.log("/session", self._rerun.TextDocument(about), static=True)
        if (labels := session.hand_labels()).version:
            text = json.dumps(asdict(labels), indent=1)
            self._stream.log("/hand_labels", self._rerun.TextDocument(text), static=True)
        for finger in session.fingers(Touch):
            yield from self._touch(session, finger, detector)
        for batch in _batches(session, Motion):
            with np.errstate(over="ignore", invalid="ignore"):  # recorded values may be extreme
                speed = np.linalg.norm(batch.velocity[:, :3], axis=1)  # (n,) m/s
            yield self._scalars("/motion/speed", batch, speed, ("speed, m/s",))
        for sample in _batches(session, Labelled):
            name = f"/samples/{sample.finger}/speed"
            yield self._scalars(name, sample, sample.speed, ("speed in the contact plane, m/s",))
        for slips in _batches(session, Slips):
            yield self._texts(f"/slip/{slips.finger}", slips, _slip_texts(slips))
        for faults in _batches(session, Faults):
            yield self._texts("/faults", faults, _fault_texts(faults))

    def _touch(self, session: Session, finger: int, detector: Detector | None) -> Iterator[tuple[str, int]]:
        zero, score = Zero(), None if detector is None else Score(detector)
        for batch in session.read(Touch, finger):
            counts = np.where(batch.valid, batch.counts, np.nan)  # (n, cells)
            yield self._scalars(
                f"/touch/{finger}", batch, counts, tuple(f"barometer {cell}" for cell in range(batch.cells))
            )
            if score is not None:
                yield from self._probability(score.push(zero.push(batch)))
        if score is not None:
            yield from self._probability(score.push(zero.flush()))

    def _probability(self, scores: Scores) -> Iterator[tuple[str, int]]:
        if len(scores):
            yield self._scalars(f"/probability/{scores.finger}", scores, scores.probability, ("slip",))

    def _scalars(
        self, entity: str, batch: Batch, values: np.ndarray[Any, Any], names: tuple[str, ...]
    ) -> tuple[str, int]:
        """Write the columns of `values` (n,) or (n, k) as series."""
        if entity not in self._named:
            self._named.add(entity)
            self._stream.log(entity, self._rerun.SeriesLines(names=list(names)), static=True)
        columns = self._rerun.Scalars.columns(scalars=np.asarray(values, np.float64).reshape(-1))
        self._stream.send_columns(
            entity, [self._times(batch)], columns.partition(np.full(len(batch), len(names)))
        )
        return entity, len(batch)

    def _texts(self, entity: str, batch: Batch, texts: list[str]) -> tuple[str, int]:
        columns = self._rerun.TextLog.columns(text=texts, level=["INFO"] * len(texts))
        self._stream.send_columns(entity, [self._times(batch)], columns)
        return entity, len(batch)

    def _times(self, batch: Batch) -> Any:  # noqa: ANN401 - type of an extra
        return self._rerun.TimeColumn(TIMELINE, timestamp=batch.time.view("datetime64[ns]"))


def check_complete(written: str, path: Path) -> None:
    """Require that a file is complete; the library does not report write errors.

    Raises:
        EndpointError: naming `path`, if it is not.
    """
    chunk: Any = import_module("rerun.chunk")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # an incomplete file gives a warning
            chunk.RrdReader(written)
    except (RuntimeError, Warning) as error:
        raise EndpointError(str(path), "is incomplete: is the disk full?") from error


def _batches(session: Session, kind: type[AnyBatch]) -> Iterator[AnyBatch]:
    for finger in session.fingers(kind):
        yield from session.read(kind, finger)


def _slip_texts(batch: Slips) -> list[str]:
    rows = zip(batch.state.tolist(), batch.probability.tolist(), strict=True)
    return [f"slip {'onset' if state == SLIP else 'end'}  p {probability:.2f}" for state, probability in rows]


def _fault_texts(batch: Faults) -> list[str]:
    rows = zip(batch.barometer.tolist(), batch.kind.tolist(), batch.active.tolist(), strict=True)
    return [
        f"finger {batch.finger} barometer {cell} {FaultKind(kind).name.lower()} {'begins' if on else 'ends'}"
        for cell, kind, on in rows
    ]
