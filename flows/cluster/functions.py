"""The two functions that Flink runs; their state is Flink's, all else is done elsewhere in this folder.

Flink keeps state by key, and deals keys out by hash: of eight all may be one worker's. So a key is a worker,
and its state a map: the states of the shares, or sessions, that were dealt to it.
"""

import builtins
from collections.abc import Iterator, Sequence
from pathlib import Path

from pyflink.common import Types
from pyflink.datastream import KeyedProcessFunction, RuntimeContext
from pyflink.datastream.state import MapStateDescriptor

from flows.cluster.claims import Claim, Done, deal_of
from flows.cluster.job_folder import JobFolder
from flows.cluster.work import Work


class WorkOff(KeyedProcessFunction):
    """Takes claims, as lines; gives a `Done`, as a line, when a share has no more.

    Args:
        place: The job's folder.
    """

    def __init__(self, place: str) -> None:
        self._place = place

    def open(self, runtime_context: RuntimeContext) -> None:
        """Build the flow, once in each worker."""
        _restore_print()
        folder = JobFolder(Path(self._place))
        self._work = Work(folder.flow(), folder.staged)
        shares = MapStateDescriptor("shares", Types.STRING(), Types.PICKLED_BYTE_ARRAY())
        self._states = runtime_context.get_map_state(shares)

    def process_element(self, value: str, ctx: object) -> Iterator[str]:  # noqa: ARG002 - as Flink calls it
        """Work off one claim."""
        claim = Claim.read(value)
        before: bytes | None = self._states.get(claim.key)
        state, done = self._work.take(before, claim)
        self._states.put(claim.key, state)
        if done:
            yield done.line()


class Assemble(KeyedProcessFunction):
    """Takes what `WorkOff` gives and writes the session when all shares are there.

    Args:
        place: The job's folder.
    """

    def __init__(self, place: str) -> None:
        self._place = place

    def open(self, runtime_context: RuntimeContext) -> None:
        """Find the job."""
        _restore_print()
        self._folder = JobFolder(Path(self._place))
        sessions = MapStateDescriptor("sessions", Types.STRING(), Types.PICKLED_BYTE_ARRAY())
        self._found = runtime_context.get_map_state(sessions)

    def process_element(self, value: str, ctx: object) -> Iterator[str]:  # noqa: ARG002 - as Flink calls it
        """Note that a share is done; give the session's name when it is written."""
        done = Done.read(value)
        before: frozenset[int] | None = self._found.get(done.key)
        found = (before or frozenset()) | {done.share}
        self._found.put(done.key, found)
        if done.error or (done.end and len(found) == len(done.end.shares)):
            self._folder.finish(done)
            yield done.session


def dealt(keys: Sequence[str], line: str) -> str:
    """The key of the worker whose turn it is, of those of all workers."""
    return keys[deal_of(line) % len(keys)]


def _restore_print() -> None:
    """Put Python's own print back: numba cannot be imported beside that of PyFlink."""
    builtins.print = getattr(getattr(builtins.print, "__self__", None), "_print", builtins.print)
