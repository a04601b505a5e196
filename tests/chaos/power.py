"""Images of a folder after a power cut: durable content, and any part of later changes."""

import os
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args
from unittest.mock import patch

import numpy as np

Tail = Literal["cut", "zeros", "garbage"]
TAILS: tuple[Tail, ...] = get_args(Tail)


@dataclass
class Disk:
    """Folder whose fsyncs are recorded while it is `watched`.

    A file is durable as of its last fsync, a name as of the last fsync of its folder. After a power cut each
    is as it was then or as it was at the end, in any mixture. Of the bytes after the durable ones a file has
    some, then nothing, zeros or garbage. File systems are not known to do more.
    """

    folder: Path
    _bytes: dict[int, bytes] = field(default_factory=dict[int, bytes])  # durable, by inode
    _names: dict[Path, dict[str, int]] = field(
        default_factory=dict[Path, dict[str, int]]
    )  # inodes, by folder
    _held: list[int] = field(default_factory=list[int])  # open descriptors, so that no inode number is reused

    @contextmanager
    def watched(self) -> Generator[None]:
        """Record each fsync."""
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

    def image(self, target: Path, keep_present: Callable[[], bool], cut: Callable[[bytes], bytes]) -> None:
        """Create a folder as a power cut may leave it.

        Args:
            target: Path of the image, which must not exist.
            keep_present: Called for each name that is not durable; returns True to keep its present state.
            cut: Returns what is left of bytes that are not durable.
        """
        self._copy(self.folder, target, keep_present, cut)

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
        self, folder: Path, target: Path, keep_present: Callable[[], bool], cut: Callable[[bytes], bytes]
    ) -> None:
        target.mkdir()
        durable, present = self._names.get(folder, {}), _listed(folder)
        for name in sorted(durable.keys() | present.keys()):
            chosen = present if durable.get(name) == present.get(name) or keep_present() else durable
            inode = chosen.get(name)
            if inode is None:
                continue
            if (folder / name).is_dir():
                self._copy(folder / name, target / name, keep_present, cut)
                continue
            kept = self._bytes.get(inode, b"")
            whole = (folder / name).read_bytes() if present.get(name) == inode else kept
            assert whole.startswith(kept), "files only grow"
            (target / name).write_bytes(kept + cut(whole[len(kept) :]))


def end(rest: bytes, at: int, tail: Tail, random: np.random.Generator) -> bytes:
    """Return what is left of bytes: the first `at`, then nothing, zeros or garbage."""
    size = max(0, len(rest) - at)
    return rest[:at] + {"cut": b"", "zeros": bytes(size), "garbage": random.bytes(size)}[tail]


def _listed(folder: Path) -> dict[str, int]:
    return {each.name: each.stat().st_ino for each in folder.iterdir()}
