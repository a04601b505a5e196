"""Container of a recording, recognised by its first bytes: Parquet, or CSV, which may be gzipped."""

import gzip
import hashlib
import io
import zlib
from pathlib import Path
from typing import Any, Final

import polars as pl

from connectors.files import trace_table
from connectors.files.csv_table import parse_csv
from connectors.files.trace_table import TraceTable, check_size
from operators.errors import InputError, os_error_reason
from storage.arrow import pa, pq

ENDINGS: Final = (".csv", ".csv.gz", ".tsv", ".txt", ".parquet")  # of recordings that can be replayed

_PARQUET: Final = b"PAR1"
_GZIP: Final = b"\x1f\x8b"
_OTHERS: Final = {  # first bytes of other formats
    b"\x89MCAP0": "an MCAP file",
    b"SQLite format 3": "a ROS 2 bag",
    b"#ROSBAG": "a ROS 1 bag",
    b"PK\x03\x04": "a ZIP file, such as NPZ or Excel",
    b"\x89HDF": "an HDF5 file",
    b"MATLAB 5.0": "a MATLAB file",
    b"\x93NUMPY": "an array of numpy",
}
_PACKED: Final = (b"\x28\xb5\x2f\xfd", b"\x78\x01", b"\x78\x5e", b"\x78\x9c", b"\x78\xda")  # zstd, zlib


def read_table(path: Path) -> TraceTable:
    """Read a CSV or Parquet file.

    Raises:
        InputError: if it cannot be read, is damaged, too large or of another format.
    """
    where, content = str(path), _read(path)
    sha256 = hashlib.sha256(content).hexdigest()
    if content.startswith(_PARQUET) or path.suffix.lower() == ".parquet":
        frame, left_out = _read_parquet(where, content)
        return TraceTable(frame, where, sha256=sha256, left_out=left_out)
    if content.startswith(_GZIP):
        content = _unzipped(where, content)
    for first, name in _OTHERS.items():
        if content.startswith(first):
            reason = f"is {name}: read it in Python and pass a DataFrame to import_frame"
            raise InputError(where, f"{reason} (docs/how-to/import.md)")
    if content.startswith(_PACKED):
        raise InputError(where, "is compressed: decompress it first, or use gzip")
    return parse_csv(content, where, sha256=sha256)


def _read(path: Path) -> bytes:
    """Return the content of a file, up to the limit."""
    try:
        with path.open("rb") as file:
            return _limited(str(path), file.read(trace_table.LIMIT + 1))
    except OSError as error:
        raise InputError(str(path), f"cannot be read: {os_error_reason(error)}") from None


def _unzipped(where: str, content: bytes) -> bytes:
    try:
        with gzip.open(io.BytesIO(content)) as file:
            return _limited(where, file.read(trace_table.LIMIT + 1))
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise InputError(where, f"is a damaged gzip file: {error}") from None


def _limited(where: str, content: bytes) -> bytes:
    if len(content) > trace_table.LIMIT:
        reason = f"is larger than {trace_table.LIMIT >> 20} MiB, the limit: split it into several files"
        raise InputError(where, reason)
    return content


def _read_parquet(where: str, content: bytes) -> tuple[pl.DataFrame, dict[str, str]]:
    """Return the columns of a Parquet file, and the reasons for those that are left out.

    Arrow reads it: of damaged files, polars 2.1 did not return.
    """
    try:
        data = pa.BufferReader(content)
        file: Any = pq.ParquetFile(data, page_checksum_verification=True)
        check_size(where, file.metadata.num_rows * file.metadata.num_columns)
        # without Arrow's threads: one that releases `data` last aborts a process that is exiting
        read: Any = file.read(use_threads=False)
        read.validate(full=True)
    except (ValueError, OSError, pa.ArrowException) as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        raise InputError(where, f"is damaged or not a Parquet file: {reason:.200}; restore a copy") from None
    columns, left_out = list[pl.Series](), dict[str, str]()
    for name, values in zip(read.column_names, read.columns, strict=True):
        try:
            columns.append(pl.Series(name, values))
        except (TypeError, ValueError, pl.exceptions.PolarsError, pl.exceptions.PanicException):
            left_out[name] = f"its values are {values.type}"
    return pl.DataFrame(columns), left_out
