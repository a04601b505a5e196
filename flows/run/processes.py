"""Process pool: results are in order, a process that dies loses only its item, workers end with their parent.

Parent and worker share one pipe. The worker receives items one by one and sends one result per item. It ends
when its end of the pipe closes, which also happens when the parent is killed.
"""

import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import ForkingPickler
from multiprocessing.resource_tracker import ensure_running
from typing import Any, Final, Generic, TypeAlias, TypeVar, cast

from operators.checks import check_at_least
from operators.errors import SlipflowError

Item = TypeVar("Item")
Result = TypeVar("Result")
Pipe: TypeAlias = "Connection[Any, Any]"
Stopped: TypeAlias = Callable[[], bool]  # returns True to stop

_POLL_INTERVAL: Final = 0.2  # s, between two checks for a request to stop
_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # of numpy's libraries
_NOT_STARTED: Final = "was not started: interrupted"


@dataclass(frozen=True)
class _Raised:
    """Error that `work` raised, to be raised in the parent."""

    error: Exception


@dataclass(eq=False)
class WorkerPool(Generic[Item, Result]):
    """Processes that work on items.

    Args:
        work: Function of a module. It returns soon after its second argument, a function, returns True, with
            a partial result.
        items: Items; they and the results are pickled.
        lost: Returns the result of an item whose process died or that was not started, given the reason.
        stopped: Returns True to stop: items in progress return early, the rest is lost.
        progress: Called with the number of finished items.
    """

    work: Callable[[Item, Stopped], Result]
    items: Sequence[Item]
    lost: Callable[[Item, str], Result]
    stopped: Stopped = lambda: False
    progress: Callable[[int], object] = lambda _done: None
    _waiting: deque[int] = field(default_factory=deque[int], init=False)
    _workers: dict[Pipe, tuple[BaseProcess, int]] = field(  # process and its item, by our end of the pipe
        default_factory=dict["Pipe", tuple[BaseProcess, int]], init=False
    )
    _results: dict[int, Result | _Raised] = field(default_factory=dict[int, Result | _Raised], init=False)
    _done: int = field(default=0, init=False)
    _stopping: bool = field(default=False, init=False)

    def results(self, jobs: int | None = None) -> Generator[Result]:
        """Yield the result of each item, in order.

        Args:
            jobs: Number of processes, each with one thread; None: one per core. 1: this process only.

        Raises:
            ParameterError: if `jobs` is below 1.
        """
        if jobs is not None:
            check_at_least("processes", "jobs", jobs, 1)
        count = min(jobs or os.cpu_count() or 1, len(self.items))
        return self._in_processes(count) if count > 1 else self._in_this_process()

    def _in_this_process(self) -> Generator[Result]:
        for done, item in enumerate(self.items, 1):
            result = self.lost(item, _NOT_STARTED) if self.stopped() else self.work(item, self.stopped)
            self.progress(done)
            yield result

    def _in_processes(self, count: int) -> Generator[Result]:
        self._waiting += range(len(self.items))
        try:
            for number in range(len(self.items)):
                while number not in self._results:
                    self._advance(count)
                result = self._results.pop(number)
                if isinstance(result, _Raised):
                    raise result.error
                yield result
        finally:
            for pipe in list(self._workers):
                pipe.close()  # workers stop after their current item
            for process, _ in self._workers.values():
                process.join()

    def _advance(self, count: int) -> None:
        """Start workers, pass on a request to stop, and receive results for a short time."""
        if not self._stopping and self.stopped():
            self._stopping = True
            for pipe in self._workers:
                _send(pipe, None)
            while self._waiting:
                self._finish(number := self._waiting.popleft(), self.lost(self.items[number], _NOT_STARTED))
        while self._waiting and len(self._workers) < count:
            self._start()
        for pipe in cast("list[Pipe]", wait(self._workers, _POLL_INTERVAL)) if self._workers else []:
            self._receive(pipe)

    def _start(self) -> None:
        context = get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(self.work, theirs), daemon=True)
        with _worker_environment():
            process.start()
        theirs.close()  # so that the end of the process closes the pipe
        self._assign(ours, process)

    def _assign(self, pipe: Pipe, process: BaseProcess) -> None:
        """Send a worker its next item, or end it."""
        if self._waiting:
            number = self._waiting.popleft()
            self._workers[pipe] = process, number
            _send(pipe, self.items[number])
        else:
            pipe.close()
            process.join()

    def _receive(self, pipe: Pipe) -> None:
        process, number = self._workers.pop(pipe)
        try:
            result = cast("Result | _Raised", pipe.recv())
        except (EOFError, OSError):
            pipe.close()
            process.join()
            reason = f"its process died with exit code {process.exitcode} (-9: perhaps out of memory)"
            result = self.lost(self.items[number], reason)
        else:
            self._assign(pipe, process)
        self._finish(number, result)

    def _finish(self, number: int, result: Result | _Raised) -> None:
        self._results[number] = result
        self._done += 1
        self.progress(self._done)


def _send(pipe: Pipe, item: object) -> None:
    with suppress(OSError):  # the worker died: its pipe reports that
        pipe.send(item)


def _serve(work: Callable[[Any, Stopped], Any], pipe: Pipe) -> None:
    """Run in a worker: process items until the pipe closes or the parent requests a stop."""
    stopping = False

    def stopped() -> bool:
        nonlocal stopping
        stopping = (
            stopping or pipe.poll()
        )  # during an item only a request to stop or the pipe's end can arrive
        return stopping

    with suppress(EOFError, OSError):  # the parent closed the pipe
        while not stopping and (item := pipe.recv()) is not None:
            try:
                result = work(item, stopped)
            except Exception as error:  # noqa: BLE001 - raised again in the parent
                result = _Raised(error)
            pipe.send_bytes(_pickled(result))


def _pickled(result: object) -> memoryview:
    """Return a pickled result, or an error if it cannot be pickled."""
    try:
        return ForkingPickler.dumps(result)
    except Exception as error:  # noqa: BLE001 - any code of the result
        reason = f"{result!r:.200} cannot be pickled: {error}"
        return ForkingPickler.dumps(_Raised(SlipflowError(reason)))


@contextmanager
def _worker_environment() -> Generator[None]:
    """Start processes with one thread each and with SIGINT and SIGTERM blocked.

    Terminals and service managers send these signals to all processes; only the parent must act on them.
    """
    ensure_running()  # else it starts with the first process and unblocks the signals again
    before = {name: os.environ.get(name) for name in _THREADS}
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        for name in _THREADS:
            os.environ.setdefault(name, "1")
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
