"""Export of the visible span of a recorded session: a table as CSV or Parquet, or all streams as MCAP."""

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from connectors.events import finger_name
from connectors.web.session_bands import SessionBands
from connectors.web.session_page import VALID_FOR, SessionCurves
from operators.batch import EVERY, UNKNOWN, Reals, Times
from operators.errors import InputError
from storage import HandLabels, Session

ROWS_MAX: Final = 1_000_000
TYPES: Final[Mapping[str, str]] = {
    "csv": "text/csv; charset=utf-8",
    "parquet": "application/vnd.apache.parquet",
    "mcap": "application/octet-stream",
}


def export_table(
    curves: SessionCurves, bands: SessionBands | None, labels: HandLabels, span: tuple[int, int], kind: str
) -> bytes:
    """Return the touch samples of all fingertips in a span as a table, with the other streams at their time.

    Columns: ``time`` (ns since 1970 UTC), ``finger`` (-1: for all), ``p0``, ``p1``, ... (counts as the page
    shows them: zeroed if the recording can be; null: no reading or no such cell), ``probability``, ``speed``
    (of the TCP, mm/s), and the labels ``arm``, ``truth`` and ``hand`` (1 slip, 0 static, -1 unknown or none).

    Args:
        curves: Curves of the session.
        bands: Labels by arm speed and true sliding.
        labels: Labels by hand.
        span: First and last time, ns.
        kind: ``csv`` or ``parquet``.

    Raises:
        InputError: if the span has too many rows, or none.
    """
    import polars as pl  # noqa: PLC0415 - slow to import

    frames = list[pl.DataFrame]()
    for (stream, finger), (time, counts) in sorted(curves.curves.items()):
        first, last = np.searchsorted(time, [span[0], span[1] + 1]).tolist()
        if stream != "touch" or first == last:
            continue
        at, values = time[first:last], counts[first:last]
        number = EVERY if finger == finger_name(EVERY) else int(finger)
        unlabelled = np.full(len(at), UNKNOWN, np.int8)
        columns = {
            "time": pl.Series(at),
            "finger": pl.Series(np.full(len(at), number, np.int16)),
            **{f"p{cell}": pl.Series(values[:, cell]).fill_nan(None) for cell in range(values.shape[1])},
            "probability": _newest(curves, ("scores", "every"), ("scores", finger), at),
            "speed": _newest(curves, ("speed", "every"), ("speed", "every"), at),
            **{name: bands.codes(name, finger, at) if bands else unlabelled for name in ("arm", "truth")},
            "hand": labels.replace(unlabelled, at, number)[0],
        }
        frames.append(pl.DataFrame(columns))
    rows = sum(map(len, frames))
    if not 0 < rows <= ROWS_MAX:
        raise InputError(
            "/export", f"has {rows:,} rows in this span, must have 1 to {ROWS_MAX:,}: zoom in or out"
        )
    widest = max(frames, key=lambda frame: frame.width).columns
    table, file = pl.concat(frames, how="diagonal").select(widest), BytesIO()
    if kind == "csv":
        table.write_csv(file)
    else:
        table.write_parquet(file)
    return file.getvalue()


def export_mcap(session: Session, span: tuple[int, int]) -> bytes:
    """Return all rows of a session in a span as an MCAP file.

    Raises:
        InputError: if the library is not installed, or the session is damaged.
        EndpointError: if the temporary file cannot be written.
    """
    from storage.exports.mcap_file import export  # noqa: PLC0415 - only for an export

    with TemporaryDirectory() as folder:
        path = Path(folder) / "span.mcap"
        export(session, path, span=span)
        return path.read_bytes()


def _newest(curves: SessionCurves, other: tuple[str, str], key: tuple[str, str], at: Times) -> Reals:
    """Return the newest value, at most 1 s old, at each time (n,); NaN if there is none."""
    found = curves.curves.get(key) or curves.curves.get(other)
    if found is None or not len(found[0]):
        return np.full(len(at), np.nan)
    time, values = found
    row = time.searchsorted(at, "right") - 1
    known = (row >= 0) & (at - time[row] <= VALID_FOR)
    newest: Reals = np.where(known, values[row].astype(np.float64), np.nan)
    return newest
