"""The two functions that Flink runs; Flink keeps their state.

Flink keeps state by key and assigns keys to workers by hash: one worker may get all of eight keys and the
others none. Therefore each worker has exactly one key, whose state is a map of the states of the worker's
shares or sessions.
"""

import builtins
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import ClassVar

from pyflink.common import Types
from pyflink.datastream import KeyedProcessFunction, RuntimeContext
from pyflink.datastream.state import MapStateDescriptor

from flows.run.cluster.job_folder import JobFolder
from flows.run.cluster.work_units import UnitResult, WorkUnit, receiver_of
from flows.run.cluster.worker import Worker


class _JobFunction(KeyedProcessFunction):
    """Base of both functions, with the job's folder and a map of states."""

    _map: ClassVar[str]  # name of the map in Flink

    def __init__(self, folder: str) -> None:
        self._path = folder

    def open(self, runtime_context: RuntimeContext) -> None:
        """Open the folder and the states, once per worker."""
        _restore_print()
        self._folder = JobFolder(Path(self._path))
        descriptor = MapStateDescriptor(self._map, Types.STRING(), Types.PICKLED_BYTE_ARRAY())
        self._states = runtime_context.get_map_state(descriptor)


class ProcessUnits(_JobFunction):
    """Function that processes work units and yields a `UnitResult` for each, as a line.

    Args:
        folder: Folder of the job.
    """

    _map = "shares"

    def open(self, runtime_context: RuntimeContext) -> None:
        """Build the flow, once per worker."""
        super().open(runtime_context)
        self._worker = Worker(self._folder.flow())

    def process_element(self, value: str, ctx: object) -> Iterator[str]:  # noqa: ARG002 - Flink's signature
        """Process one unit."""
        unit = WorkUnit.from_line(value)
        before: bytes | None = self._states.get(unit.key)
        state, results = self._worker.process(before, unit)
        self._states.put(unit.key, state)
        for result in results:
            yield result.to_line()


class WriteSessions(_JobFunction):
    """Function that stores the results of `ProcessUnits`, and writes a session when it has all of them.

    Args:
        folder: Folder of the job.
    """

    _map = "results"

    def process_element(self, value: str, ctx: object) -> Iterator[str]:  # noqa: ARG002 - Flink's signature
        """Store a result; yield the session's name when it is written."""
        result = UnitResult.from_line(value)
        self._states.put(result.key, value)
        shares = result.all_keys()
        if result.error or (shares and all(self._states.contains(keys[-1]) for keys in shares)):
            session = result.unit.session
            self._folder.finish(result, [map(self._result, keys) for keys in shares])
            for key in list(self._states.keys()):
                if key.startswith(f"{session}/"):
                    self._states.remove(key)
            yield session

    def _result(self, key: str) -> UnitResult:
        return UnitResult.from_line(self._states.get(key))


def worker_key(keys: Sequence[str], line: str) -> str:
    """Return the key of the worker that gets a line; `keys` has one key per worker."""
    return keys[receiver_of(line) % len(keys)]


def _restore_print() -> None:
    """Restore Python's own print: numba cannot be imported while PyFlink's replaces it."""
    builtins.print = getattr(getattr(builtins.print, "__self__", None), "_print", builtins.print)
