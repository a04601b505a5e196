"""How much a write-ahead log of SQLite should hold.

SQLite ends its recovery silently at the first frame whose checksum fails, so a flipped bit would take back
events, and their numbers would be given twice. Source: https://www.sqlite.org/fileformat2.html, section 4.
"""

import os
from pathlib import Path
from struct import Struct

_HEADER = Struct(">8xI4xII8x")  # page size, two salts
_FRAME = Struct(">4xIII8x")  # pages of the database after a commit, else 0; two salts


def committed_frames(path: Path) -> int:
    """How many frames the log holds up to its last commit, damaged or not; 0 where there is no log."""
    try:
        log = path.open("rb")
    except FileNotFoundError:
        return 0
    with log:
        size = os.fstat(log.fileno()).st_size
        header = log.read(_HEADER.size)
        if len(header) < _HEADER.size:
            return 0
        page, *salts = _HEADER.unpack(header)
        if not 512 <= page <= 65536:  # noqa: PLR2004 - what SQLite allows: this one was damaged
            return 1
        committed = number = 0
        known = {tuple(salts)}
        while len(frame := log.read(_FRAME.size)) == _FRAME.size:
            number += 1
            pages, *salts = _FRAME.unpack(frame)
            if number == 1:
                known.add(tuple(salts))  # should the header be damaged
            if log.seek(page, os.SEEK_CUR) > size:
                break  # a kill within a write
            if pages and tuple(salts) in known:
                committed = number
        return committed
