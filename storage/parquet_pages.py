"""Sizes that a Parquet file declares in its footer and page headers, read before anything is unpacked.

Arrow unpacks a page to the size in its header, up to 2 GiB, and pyarrow aborts the process if it is asked for
the metadata of an inconsistent column. Footer and page headers are Thrift structs in the compact protocol.

References:
    parquet-format/src/main/thrift/parquet.thrift and doc/specs/thrift-compact-protocol.md of Apache Thrift.
"""

from collections.abc import Callable
from itertools import chain
from typing import Any, Final, TypeAlias

Struct: TypeAlias = dict[int, Any]  # values by field number
Sizes: TypeAlias = tuple[int, int, int]  # rows of a file, and the bytes and values that its pages unpack to

MAGIC: Final = b"PAR1"
# field numbers in parquet.thrift
ROW_GROUPS, COLUMNS, GROUP_ROWS, META_DATA = 4, 1, 3, 3  # of FileMetaData, RowGroup, RowGroup, ColumnChunk
CHUNK_VALUES, CHUNK_SIZE, DATA_OFFSET, DICTIONARY_OFFSET = 5, 7, 9, 11  # of ColumnMetaData
UNPACKED_SIZE, PACKED_SIZE = 2, 3  # of PageHeader
PAGE_KINDS: Final = 5, 7, 8  # of PageHeader: data page, dictionary, data page of version 2
VALUES: Final = 1  # of each of them


def declared_sizes(data: bytes) -> Sizes:
    """Return the sizes that a Parquet file declares.

    Raises:
        ValueError: if the file is malformed.
    """
    try:
        if data[-4:] != MAGIC:
            raise ValueError("the file does not end with a Parquet footer")
        begin = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
        groups = _struct(data, begin)[0][ROW_GROUPS]
        rows = [group[GROUP_ROWS] for group in groups]
        chunks = [chunk[META_DATA] for group in groups for chunk in group[COLUMNS]]
        pages = list(chain.from_iterable(_pages(data, chunk) for chunk in chunks))
        values = [page[kind][VALUES] for page in pages for kind in PAGE_KINDS if kind in page]
        sizes = [page[UNPACKED_SIZE] for page in pages]
        if min(chain(rows, sizes, values), default=0) < 0:
            raise ValueError("a footer or page header has a negative size")
        return sum(rows), sum(sizes), sum(values)
    except (AttributeError, IndexError, KeyError, TypeError, RecursionError) as error:
        raise ValueError("malformed footer or page header") from error


def _pages(data: bytes, chunk: Struct) -> list[Struct]:
    """Return the page headers of a column chunk; Arrow reads none of a chunk without values."""
    if chunk[CHUNK_VALUES] <= 0:
        return []
    begin = min(chunk[DATA_OFFSET], chunk.get(DICTIONARY_OFFSET) or chunk[DATA_OFFSET])
    at, end, pages = begin, begin + chunk[CHUNK_SIZE], list[Struct]()
    while at < end:
        page, at = _struct(data, at)
        if page[PACKED_SIZE] < 0:
            raise ValueError("a page has a negative size")
        at += page[PACKED_SIZE]
        pages.append(page)
    if at != end:
        raise ValueError("the pages of a column do not end where its footer says")
    return pages


def _struct(data: bytes, at: int) -> tuple[Struct, int]:
    """Return the fields of the struct at a position, and the position after it; as the other readers do."""
    if at < 0:
        raise IndexError
    fields: Struct = {}  # `Struct()` takes five times as long
    number = 0
    while head := data[at]:
        at += 1
        if head >> 4:
            number += head >> 4
        else:
            number, at = _integer(data, at)
        kind = head & 15
        if 0 < kind <= _FALSE:
            fields[number] = kind == _TRUE
        else:
            fields[number], at = _READERS[kind](data, at)
    return fields, at + 1


def _list(data: bytes, at: int) -> tuple[list[Any], int]:
    values: list[Any] = []
    head = data[at]
    count, at = (head >> 4, at + 1) if head >> 4 < _LONG else _varint(data, at + 1)
    for _ in range(count):
        value, at = _READERS[head & 15](data, at)
        values.append(value)
    return values, at


def _binary(data: bytes, at: int) -> tuple[bytes, int]:
    size, at = _varint(data, at)
    return _bytes(data, at, size)


def _double(data: bytes, at: int) -> tuple[bytes, int]:
    return _bytes(data, at, 8)


def _bytes(data: bytes, at: int, size: int) -> tuple[bytes, int]:
    if at + size > len(data):  # else a long list of values beyond the end would be read
        raise IndexError
    return data[at : at + size], at + size


def _byte(data: bytes, at: int) -> tuple[int, int]:
    return data[at], at + 1


def _integer(data: bytes, at: int) -> tuple[int, int]:
    number, at = _varint(data, at)
    return number >> 1 ^ -(number & 1), at


def _varint(data: bytes, at: int) -> tuple[int, int]:
    number = shift = 0
    while (byte := data[at]) > 127:  # noqa: PLR2004
        if shift == 63:  # noqa: PLR2004 - 10 bytes have 64 bits
            raise ValueError("an integer in a footer or page header has more than 64 bits")
        number |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
    return number | byte << shift, at + 1


_TRUE, _FALSE, _BYTE, _DOUBLE, _BINARY, _LIST, _SET, _STRUCT = 1, 2, 3, 7, 8, 9, 10, 12
_INTEGERS = (4, 5, 6)  # 16, 32 and 64 bits
_LONG = 15  # instead of the length of a list, which follows
_READERS: Final[dict[int, Callable[[bytes, int], tuple[Any, int]]]] = {
    **dict.fromkeys((_TRUE, _FALSE, _BYTE), _byte),  # elements of a list
    **dict.fromkeys(_INTEGERS, _integer),
    _DOUBLE: _double,
    _BINARY: _binary,
    **dict.fromkeys((_LIST, _SET), _list),
    _STRUCT: _struct,
}
