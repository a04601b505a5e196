"""Check of a folder before a run: permission, free space and time of an fsync."""

import os
import shutil
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Final

from operators.errors import EndpointError, os_error_reason
from operators.ports import Finding

FREE_MIN: Final = 1e9  # bytes
SYNC_MAX: Final = 0.05  # s; on slower disks a power cut costs more rows than `storage.dataset.Dataset` states
SYNCS: Final = 20
BLOCK: Final = 4096  # bytes written before each fsync


def check_disk(folder: Path) -> list[Finding]:
    """Return what a run that writes below `folder` would find; `folder` need not exist.

    Raises:
        EndpointError: if it cannot be written.
    """
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    try:
        free, times = shutil.disk_usage(existing).free, _sync_times(existing)
    except OSError as error:
        raise EndpointError(str(folder), f"cannot be written: {os_error_reason(error)}") from None
    space = f"{free / 1e9:,.1f} GB free"
    sync = f"fsync {median(times) * 1e3:.1f} ms, longest of {SYNCS} {max(times) * 1e3:.1f} ms"
    return [
        Finding(str(folder), space)
        if free >= FREE_MIN
        else Finding(str(folder), f"{space}: free some space, or use another disk", "bad"),
        Finding(str(folder), sync)
        if median(times) <= SYNC_MAX
        else Finding(str(folder), f"{sync}: use a faster disk; a power cut may cost more than 0.3 s", "bad"),
    ]


def _sync_times(folder: Path) -> list[float]:
    """Return the durations (s) of fsyncs after appending a block to a temporary file."""
    times = list[float]()
    with tempfile.TemporaryFile(dir=folder) as file:
        for _ in range(SYNCS):
            os.write(file.fileno(), bytes(BLOCK))
            start = time.perf_counter()
            os.fsync(file.fileno())
            times.append(time.perf_counter() - start)
    return times
