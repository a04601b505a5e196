"""What a power cut may leave of a folder: what was made durable, and any of what came after that."""

import os
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal
from unittest.mock import patch

import numpy as np

Tail = Literal["cut", "zeros", "garbage"]


@dataclass
class Disk:
    """Watches a folder while it is `watched`.

    A file is durable as it was at its last fsync, a name as at the last fsync of its folder. After a power
    cut each may be so, or as it was at the end, in any mixture; of the bytes after the durable ones of a file
    some may be there, then nothing, zeros or garbage. That is more than file systems are known to do.
    """

    folder: Path
    _bytes: dict[int, bytes] = field(default_factory=dict[int, bytes])  # durable, by inode
    _names: dict[Path, dict[str, int]] = field(
        default_factory=dict[Path, dict[str, int]]
    )  # inodes, by folder
    _held: list[int] = field(default_factory=list[int])  # descriptors, so that no inode is used again

    @contextmanager
    def watched(self) -> Generator[None]:
        """See what is made durable."""
        fsync = os.fsync

        def seen(number: int) -> None:
            fsync(number)
            self._note(number)

        try:
            with patch("os.fsync", seen):
                yield
        finally:
            for number in self._held:
                os.close(number)

    def image(self, place: Path, now: Callable[[], bool], cut: Callable[[bytes], bytes]) -> None:
        """Make a folder as a power cut may leave it.

        Args:
            place: Where; it may not exist.
            now: Asked for each name that is not durable: whether it is as it is now.
            cut: Gives what is left of the bytes that are not durable.
        """
        self._copy(self.folder, place, now, cut)

    def _note(self, number: int) -> None:
        path = Path(f"/proc/self/fd/{number}").readlink()
        if not path.is_relative_to(self.folder):
            return
        inode = os.fstat(number).st_ino
        if path.is_dir():
            self._names[path] = _listed(path)
        elif path.exists():
            if inode not in self._bytes:
                self._held.append(os.dup(number))
            self._bytes[inode] = path.read_bytes()

    def _copy(
        self, folder: Path, place: Path, now: Callable[[], bool], cut: Callable[[bytes], bytes]
    ) -> None:
        place.mkdir()
        durable, present = self._names.get(folder, {}), _listed(folder)
        for name in sorted(durable.keys() | present.keys()):
            chosen = present if durable.get(name) == present.get(name) or now() else durable
            inode = chosen.get(name)
            if inode is None:
                continue
            if (folder / name).is_dir():
                self._copy(folder / name, place / name, now, cut)
                continue
            kept = self._bytes.get(inode, b"")
            whole = (folder / name).read_bytes() if present.get(name) == inode else kept
            assert whole.startswith(kept), "files only grow"
            (place / name).write_bytes(kept + cut(whole[len(kept) :]))


def end(rest: bytes, at: int, tail: Tail, random: np.random.Generator) -> bytes:
    """What is left of bytes: the first `at`, if there are more, then nothing, zeros or garbage."""
    size = max(0, len(rest) - at)
    return rest[:at] + {"cut": b"", "zeros": bytes(size), "garbage": random.bytes(size)}[tail]


def _listed(folder: Path) -> dict[str, int]:
    return {each.name: each.stat().st_ino for each in folder.iterdir()}
