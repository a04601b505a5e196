"""Sizes that a Parquet file declares in its footer and page headers, read before anything is unpacked.

Arrow unpacks a page to the size in its header, up to 2 GiB, and pyarrow aborts the process if it is asked for
the metadata of an inconsistent column. Footer and page headers are Thrift structs in the compact protocol.

References:
    parquet-format/src/main/thrift/parquet.thrift and doc/specs/thrift-compact-protocol.md of Apache Thrift.
"""

from itertools import chain
from typing import Any, Final, TypeAlias

Struct: TypeAlias = dict[int, Any]  # values by field number

MAGIC: Final = b"PAR1"
# field numbers in parquet.thrift
ROW_GROUPS, COLUMNS, GROUP_ROWS, META_DATA = 4, 1, 3, 3  # of FileMetaData, RowGroup, RowGroup, ColumnChunk
CHUNK_VALUES, CHUNK_SIZE, DATA_OFFSET, DICTIONARY_OFFSET = 5, 7, 9, 11  # of ColumnMetaData
UNPACKED_SIZE, PACKED_SIZE = 2, 3  # of PageHeader
PAGE_KINDS: Final = 5, 7, 8  # of PageHeader: data page, dictionary, data page of version 2
VALUES: Final = 1  # of each of them


def declared_sizes(data: bytes) -> tuple[int, int, int]:
    """Return the rows of a Parquet file, and the bytes and values that its pages unpack to.

    Raises:
        ValueError: if the file is malformed.
    """
    try:
        if data[-4:] != MAGIC:
            raise ValueError("the file does not end with a Parquet footer")
        begin = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
        groups = _Reader(data, begin).struct()[ROW_GROUPS]
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
    reader, end, pages = _Reader(data, begin), begin + chunk[CHUNK_SIZE], list[Struct]()
    while reader.at < end:
        page = reader.struct()
        if page[PACKED_SIZE] < 0:
            raise ValueError("a page has a negative size")
        reader.at += page[PACKED_SIZE]
        pages.append(page)
    if reader.at != end:
        raise ValueError("the pages of a column do not end where its footer says")
    return pages


class _Reader:
    """Position in a buffer, and the methods that read a value there and advance it."""

    def __init__(self, data: bytes, at: int) -> None:
        if at < 0:
            raise IndexError
        self.data, self.at = data, at

    def struct(self) -> Struct:
        """Read the fields of a struct."""
        data, fields, number = self.data, Struct(), 0
        while head := data[self.at]:
            self.at += 1
            number = number + (head >> 4) if head >> 4 else self._integer()
            kind = head & 15
            fields[number] = kind == _TRUE if kind in (_TRUE, _FALSE) else self._value(kind)
        self.at += 1
        return fields

    def _value(self, kind: int) -> Any:  # noqa: ANN401 - as the file declares
        if kind in _INTEGERS:
            return self._integer()
        if kind in (_TRUE, _FALSE, _BYTE):
            return self._byte()
        if kind == _STRUCT:
            return self.struct()
        if kind in (_LIST, _SET):
            head = self._byte()
            count = head >> 4
            return [self._value(head & 15) for _ in range(self._varint() if count == _LONG else count)]
        if kind not in (_DOUBLE, _BINARY):
            raise ValueError(f"unexpected type {kind} in a footer or page header")
        size = 8 if kind == _DOUBLE else self._varint()
        self.at += size
        if self.at > len(self.data):  # else a long list of values beyond the end would be read
            raise IndexError
        return self.data[self.at - size : self.at]

    def _byte(self) -> int:
        self.at += 1
        return self.data[self.at - 1]

    def _integer(self) -> int:
        number = self._varint()
        return number >> 1 ^ -(number & 1)

    def _varint(self) -> int:
        data, number = self.data, 0
        for shift in range(0, 70, 7):  # 10 bytes have 64 bits
            byte = data[self.at]  # not `_byte`: most of the time was in calls
            self.at += 1
            number |= (byte & 127) << shift
            if byte < 128:  # noqa: PLR2004
                return number
        raise ValueError("an integer in a footer or page header has more than 64 bits")


_TRUE, _FALSE, _BYTE, _DOUBLE, _BINARY, _LIST, _SET, _STRUCT = 1, 2, 3, 7, 8, 9, 10, 12
_INTEGERS = (4, 5, 6)  # 16, 32 and 64 bits
_LONG = 15  # instead of the length of a list, which follows
