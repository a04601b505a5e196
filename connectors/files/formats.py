"""Readers of files by their format."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from connectors.files.trace_table import TraceTable


def read_table(source: str | Path, *, separator: str = "", header: Sequence[str] = ()) -> "TraceTable":
    """Read a file of any supported format; its ending names the format, CSV by default.

    Args:
        source: The file.
        separator: Separator of a CSV file (default: detected).
        header: Names of the columns of a CSV file without such a line.

    Raises:
        InputError: if it cannot be read, or has no table.
        ParameterError: if an option is not for this format.
    """
    path = Path(source)
    if path.suffix == ".parquet":
        from connectors.files.parquet_table import read_parquet  # noqa: PLC0415 - slow import

        return read_parquet(path)
    if path.suffix == ".npz":
        from connectors.files.npz_table import read_npz  # noqa: PLC0415 - slow import

        return read_npz(path)
    from connectors.files.csv_table import read_csv  # noqa: PLC0415 - slow import

    return read_csv(path, separator, header)
