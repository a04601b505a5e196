"""Readers of files by their format."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from operators.errors import ParameterError

if TYPE_CHECKING:
    from connectors.files.trace_table import TraceTable

ENDINGS: Final = (".csv", ".csv.gz", ".tsv", ".txt", ".parquet", ".npz", ".mcap", ".db3")

# the readers are slow to import
# ruff: noqa: PLC0415


def read_table(
    source: str | Path,
    *,
    separator: str = "",
    header: Sequence[str] = (),
    lenient: bool = False,
    topic: str = "",
    motion_topic: str = "",
) -> "TraceTable":
    """Read a file of any supported format; its ending names the format, CSV by default.

    Args:
        source: The file, or the folder of a ROS 2 bag.
        separator: Separator of a CSV file (default: detected).
        header: Names of the columns of a CSV file without such a line.
        lenient: Accept a CSV file whose last line is cut off.
        topic: Topic of an MCAP file or bag with the fingertip (default: its only topic).
        motion_topic: Topic with the motion, if it is another one.

    Raises:
        InputError: if it cannot be read, or has no table.
        ParameterError: if a topic is given for a format without topics.
    """
    from connectors.files.bag_table import is_bag, read_bag

    path = Path(source)
    if path.suffix == ".mcap":
        from connectors.files.mcap_table import read_mcap

        return read_mcap(path, topic, motion_topic)
    if is_bag(path):
        return read_bag(path, topic, motion_topic)
    if topic or motion_topic:
        must_be = f"left out: {path.name} is neither an MCAP file nor a ROS 2 bag"
        raise ParameterError("import", "topic", topic or motion_topic, must_be)
    if path.suffix == ".parquet":
        from connectors.files.parquet_table import read_parquet

        return read_parquet(path)
    if path.suffix == ".npz":
        from connectors.files.npz_table import read_npz

        return read_npz(path)
    from connectors.files.csv_table import read_csv

    return read_csv(path, separator, header, lenient=lenient)
