"""Container of a recording, recognised by its first bytes: Parquet, or text, which may be gzipped."""

import gzip
import hashlib
import io
import re
import zlib
from pathlib import Path
from typing import Any, Final

import polars as pl

from connectors.files.raw_table import RawTable, check_size
from connectors.files.text_table import IN_PYTHON, parse_text
from operators.errors import InputError
from storage.arrow import pa, pq
from storage.files import read

LIMIT: Final = 1 << 29  # bytes of a file, packed or unpacked

_PARQUET: Final = b"PAR1"
_GZIP: Final = b"\x1f\x8b"
_ARRAYS: Final = f"{IN_PYTHON} (arrays.py)"
_BAG: Final = f"{IN_PYTHON} (bag.py)"
_OTHERS: Final[dict[bytes, tuple[str, str]]] = {  # name and remedy by the first bytes of other formats
    rb"\x89MCAP0": ("an MCAP file", f"{IN_PYTHON} (mcap_json.py, or bag.py for ROS messages)"),
    rb"SQLite format 3": ("a ROS 2 bag or another SQLite file", _BAG),
    rb"#ROSBAG": ("a ROS 1 bag", _BAG),
    rb"PK\x03\x04(?s:.*)\.npy": ("an NPZ file", _ARRAYS),
    rb"PK\x03\x04|\xd0\xcf\x11\xe0": ("an Excel file or an archive", "save it as CSV, or unpack it"),
    rb"\x89HDF": ("an HDF5 file", _ARRAYS),
    rb"MATLAB [57]": ("a MATLAB file", _ARRAYS),
    rb"\x93NUMPY": ("an array of numpy", _ARRAYS),
    rb"\s*[{\[]\s*[\"{\[]": ("a JSON file", f"{IN_PYTHON} (polars.read_json)"),
    rb"\s*<(\?xml|!|html)|%PDF": ("an XML, HTML or PDF file", "save its table as CSV"),
}


def read_table(path: Path, separator: str | None = None) -> RawTable:
    """Read a Parquet file, or a CSV file whose `separator` is detected unless it is named.

    Raises:
        InputError: if it cannot be read, is damaged, too large or of another format.
    """
    where = str(path)
    content = read(path, LIMIT)
    sha256 = hashlib.sha256(content).hexdigest()
    if content.startswith(_GZIP):
        content = _unzipped(where, content)
    if content.startswith(_PARQUET) or path.suffix.lower() == ".parquet":
        return _read_parquet(where, content, sha256)
    for first, (name, remedy) in _OTHERS.items():
        if re.match(first, content[: 1 << 12]):
            raise InputError(where, f"is {name}: {remedy}")
    return parse_text(content, where, sha256, separator)


def _unzipped(where: str, content: bytes) -> bytes:
    """Return the content of a gzip file of at most `LIMIT` bytes."""
    try:
        with gzip.open(io.BytesIO(content)) as file:
            found = file.read(LIMIT + 1)
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise InputError(where, f"is a damaged gzip file: {error}") from None
    if len(found) > LIMIT:
        raise InputError(where, f"unpacks to more than {LIMIT >> 20} MiB, the limit: split it into files")
    return found


def _read_parquet(where: str, content: bytes, sha256: str) -> RawTable:
    """Return the columns of a Parquet file.

    Arrow reads it: of damaged files, polars 2.1 did not return.
    """
    try:
        data = pa.BufferReader(content)
        file: Any = pq.ParquetFile(data, page_checksum_verification=True)
        check_size(where, file.metadata.num_rows * file.metadata.num_columns, file.metadata.num_columns)
        # without Arrow's threads: one that releases `data` last aborts a process that is exiting
        table: Any = file.read(use_threads=False)
        table.validate(full=True)
    except (ValueError, OSError, pa.ArrowException) as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        raise InputError(where, f"is damaged or not a Parquet file: {reason:.200}; restore a copy") from None
    columns, left_out = list[pl.Series](), dict[str, str]()
    for name, values in zip(table.column_names, table.columns, strict=True):
        if table.column_names.count(name) > 1:
            left_out[name] = "it occurs twice"
            continue
        try:
            columns.append(pl.Series(name, values))
        except (TypeError, ValueError, pl.exceptions.PolarsError, pl.exceptions.PanicException):
            left_out[name] = f"its values are {values.type}"
    return RawTable.of(pl.DataFrame(columns), where, left_out, sha256)
