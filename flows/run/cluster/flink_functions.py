"""The two functions that Flink runs; their state is Flink's, all else is done elsewhere in this folder.

Flink keeps state by key, and deals keys out to workers by hash: one worker may get all keys of eight, and the
others none. So there is one key for each worker, and its state is a map: the states of the shares, or
sessions, that were dealt to that worker.
"""

import builtins
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import ClassVar

from pyflink.common import Types
from pyflink.datastream import KeyedProcessFunction, RuntimeContext
from pyflink.datastream.state import MapStateDescriptor

from flows.run.cluster.job_folder import JobFolder
from flows.run.cluster.work_units import Claim, Done, deal_of
from flows.run.cluster.worker import Work


class _JobFunction(KeyedProcessFunction):
    """What both have in common: the job's folder, and a map of states."""

    _map: ClassVar[str]  # what Flink calls the map

    def __init__(self, place: str) -> None:
        self._place = place

    def open(self, runtime_context: RuntimeContext) -> None:
        """Find the job and its states, once in each worker."""
        _restore_print()
        self._folder = JobFolder(Path(self._place))
        descriptor = MapStateDescriptor(self._map, Types.STRING(), Types.PICKLED_BYTE_ARRAY())
        self._states = runtime_context.get_map_state(descriptor)


class WorkOff(_JobFunction):
    """Takes claims, as lines; gives a `Done`, as a line, when a share has no more.

    Args:
        place: The job's folder.
    """

    _map = "shares"

    def open(self, runtime_context: RuntimeContext) -> None:
        """Build the flow, once in each worker."""
        super().open(runtime_context)
        self._work = Work(self._folder.flow(), self._folder.staged)

    def process_element(self, value: str, ctx: object) -> Iterator[str]:  # noqa: ARG002 - as Flink calls it
        """Work off one claim."""
        claim = Claim.read(value)
        before: bytes | None = self._states.get(claim.key)
        state, done = self._work.take(before, claim)
        self._states.put(claim.key, state)
        if done:
            yield done.line()


class Assemble(_JobFunction):
    """Takes what `WorkOff` gives and writes the session when all shares are there.

    Args:
        place: The job's folder.
    """

    _map = "sessions"

    def process_element(self, value: str, ctx: object) -> Iterator[str]:  # noqa: ARG002 - as Flink calls it
        """Note that a share is done; give the session's name when it is written."""
        done = Done.read(value)
        before: frozenset[int] | None = self._states.get(done.key)
        found = (before or frozenset()) | {done.share}
        self._states.put(done.key, found)
        if done.error or (done.end and len(found) == len(done.end.shares)):
            self._folder.finish(done)
            yield done.session


def dealt(keys: Sequence[str], line: str) -> str:
    """The key of the worker that a line is dealt to; `keys` has one for each worker."""
    return keys[deal_of(line) % len(keys)]


def _restore_print() -> None:
    """Put Python's own print back: numba cannot be imported beside that of PyFlink."""
    builtins.print = getattr(getattr(builtins.print, "__self__", None), "_print", builtins.print)
