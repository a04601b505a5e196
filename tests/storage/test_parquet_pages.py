"""Declared sizes of Parquet files."""

from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from storage.parquet_pages import declared_sizes


def varint(number: int) -> bytes:
    rest, digit = divmod(number, 128)
    return bytes([digit | 128]) + varint(rest) if rest else bytes([digit])


def struct(fields: dict[int, Any]) -> bytes:
    """Encode fields: integers, lists of structs, and structs."""
    data = b""
    for number, value in fields.items():
        kind = {int: 6, list: 9, dict: 12}[type(value)]
        data += bytes([kind]) + varint(2 * number)
        if isinstance(value, int):
            data += varint(2 * value if value >= 0 else -2 * value - 1)
        elif isinstance(value, list):
            structs = cast("list[dict[int, Any]]", value)
            data += bytes([15 << 4 | 12]) + varint(len(structs)) + b"".join(map(struct, structs))
        else:
            data += struct(value)
    return data + b"\0"


def footed(footer: bytes) -> bytes:
    return footer + len(footer).to_bytes(4, "little") + b"PAR1"


def file(page: dict[int, Any], *, rows: int = 1, size: int | None = None) -> bytes:
    """Encode a file of one page without data."""
    packed = struct(page)
    column = {5: 1, 7: len(packed) if size is None else size, 9: 4}
    return b"PAR1" + packed + footed(struct({3: rows, 4: [{1: [{3: column}], 3: rows}]}))


@settings(deadline=None, max_examples=25)
@given(
    rows=st.integers(0, 3000),
    groups=st.integers(1, 4),
    version=st.sampled_from(["1.0", "2.0"]),
    dictionary=st.booleans(),
)
def test_declared_sizes_are_those_that_pyarrow_reports(
    rows: int, groups: int, version: str, *, dictionary: bool
) -> None:
    cells = cast("Any", pa).FixedSizeListArray.from_arrays(np.arange(6 * rows) % 97, 6)
    table = cast("Any", pa).table({"time": np.arange(rows), "counts": cells})
    sink = pa.BufferOutputStream()
    cast("Any", pq).write_table(
        table,
        sink,
        row_group_size=rows // groups + 1,
        data_page_size=1000,
        data_page_version=version,
        use_dictionary=dictionary,
    )
    data = sink.getvalue().to_pybytes()
    about: Any = pq.ParquetFile(pa.BufferReader(data)).metadata
    columns = [
        about.row_group(group).column(number)
        for group in range(about.num_row_groups)
        for number in range(about.num_columns)
    ]
    found, unpacked, values = declared_sizes(data)
    assert found == rows
    entries = values - sum(column.num_values for column in columns)
    assert 0 <= entries <= (rows + 97 * groups) * dictionary  # values of dictionaries
    headers = sum(column.total_uncompressed_size for column in columns) - unpacked
    assert 0 <= headers <= 100 * len(columns) * (1 + 8 * 6 * rows // 1000)


def test_a_page_that_unpacks_to_two_gigabytes_counts_with_all_of_them() -> None:
    assert declared_sizes(file({1: 0, 2: 2**31 - 1, 3: 0, 5: {1: 10**9}})) == (1, 2**31 - 1, 10**9)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"PAR1",
        b"PAR1" + bytes(100),
        b"PAR1" + (2**31).to_bytes(4, "little") + b"PAR1",
        file({1: 0, 2: -1, 3: 0}),
        file({1: 0, 2: 5, 3: 0, 5: {1: -1}}),
        file({1: 0, 2: 5, 3: 0}, rows=-1),
        file({1: 0, 3: 0}),
        file({1: 0, 2: 5, 3: 2**40}),
        file({1: 0, 2: 5, 3: 0}, size=3),
        b"PAR1" + footed(b"\x1c" * 5000),
        b"PAR1" + footed(b"\x16" + b"\xff" * 50),
        footed(b"\x49\x1c\x19\x1c\x38\x0c" + bytes(range(1, 13)) + b"\x00\x26\x02\x00\x00"),
    ],
    ids=[
        "empty",
        "short",
        "zeros",
        "length",
        "negative size",
        "negative values",
        "negative rows",
        "missing",
        "beyond",
        "ends",
        "deep",
        "long",
        "text",
    ],
)
def test_malformed_files_are_reported(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"Parquet footer|malformed|negative|do not end|64 bits"):
        declared_sizes(data)


def test_a_list_that_is_longer_than_the_file_is_not_read_on() -> None:
    footer = bytes([4 << 4 | 9, 15 << 4 | 7, *[0xFF] * 7, 0x7F])  # field 4: a list of 2**56 - 1 doubles
    with pytest.raises(ValueError, match="malformed footer"):
        declared_sizes(b"PAR1" + footer + len(footer).to_bytes(4, "little") + b"PAR1")
