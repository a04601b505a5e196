"""Work spread over processes of this machine: results in order, and a process that dies costs its item only.

Parent and worker share a pipe and nothing else. The worker is sent items one by one, tells how far it is, and
sends a result for each. It ends when its end of the pipe closes, as it does when the parent dies, however.
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
from multiprocessing.resource_tracker import ensure_running
from time import monotonic
from typing import Any, Final, Generic, TypeAlias, TypeVar, cast

Item = TypeVar("Item")
Result = TypeVar("Result")
Pipe: TypeAlias = "Connection[Any, Any]"
Watch: TypeAlias = Callable[[int], bool]  # is told how far an item is, e.g. in rows; says whether to stop

_TELL_EVERY: Final = 0.2  # s, at most
_LOOK_EVERY: Final = 0.2  # s, whether somebody asked to stop
_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # of numpy's libraries
_UNBEGUN: Final = "was not begun: interrupted"


@dataclass
class _Worker:
    """A process, and what it is at."""

    process: BaseProcess
    number: int = -1  # of the item
    steps: int = 0  # how far it is with it
    stopping: bool = False  # it was told to


@dataclass(eq=False)
class Spread(Generic[Item, Result]):
    """Work on items, spread over processes.

    Args:
        work: A function of a module, which processes find by its name. It returns soon after its `Watch` says
            so, with what it has.
        items: What to work on; they and the results are pickled.
        lost: The result of an item whose process died, or that was not begun, and why.
        stopped: Whether to stop: what is being worked on is told, the rest is lost.
        progress: Told how many items are done, and how far all are, in what `work` tells its `Watch`.
    """

    work: Callable[[Item, Watch], Result]
    items: Sequence[Item]
    lost: Callable[[Item, str], Result]
    stopped: Callable[[], bool] = lambda: False
    progress: Callable[[int, int], object] = lambda _done, _steps: None
    _waiting: deque[int] = field(default_factory=deque[int], init=False)
    _workers: dict[Pipe, _Worker] = field(default_factory=dict[Pipe, _Worker], init=False)  # by our end
    _found: dict[int, Result] = field(default_factory=dict[int, Result], init=False)  # whose turn is to come
    _done: int = field(default=0, init=False)
    _steps: int = field(default=0, init=False)

    def results(self, jobs: int) -> Generator[Result]:
        """The result of each item, in order, from `jobs` processes, each in one thread; 1: none but this."""
        if min(jobs, len(self.items)) <= 1:
            yield from self._here()
            return
        self._waiting += range(len(self.items))
        try:
            for number in range(len(self.items)):
                while number not in self._found:
                    self._go_on(jobs)
                yield self._found.pop(number)
        finally:
            for pipe in self._workers:
                pipe.close()  # whoever is still at work stops
            for worker in self._workers.values():
                worker.process.join()

    def _here(self) -> Generator[Result]:
        for number, item in enumerate(self.items):
            begun = not self.stopped()
            self._finish(number, self.work(item, self._watch()) if begun else self.lost(item, _UNBEGUN))
            yield self._found.pop(number)

    def _watch(self) -> Watch:
        before = self._steps

        def watch(steps: int) -> bool:
            self._steps = before + steps
            self.progress(self._done, self._steps)
            return self.stopped()

        return watch

    def _go_on(self, jobs: int) -> None:
        """Give work to those who have none, and hear what the others say."""
        if self.stopped():
            for pipe, worker in self._workers.items():
                if not worker.stopping:
                    worker.stopping = True
                    with suppress(OSError):  # it died: it will be heard of
                        pipe.send(None)
            while self._waiting:
                self._finish(number := self._waiting.popleft(), self.lost(self.items[number], _UNBEGUN))
            if not self._workers:
                return
        while self._waiting and len(self._workers) < jobs:
            self._start()
        for pipe in cast("list[Pipe]", wait(self._workers, _LOOK_EVERY)):
            self._hear(pipe)

    def _start(self) -> None:
        context = get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(self.work, theirs), daemon=True)
        with _apart():
            process.start()
        theirs.close()  # so that its end is heard
        self._workers[ours] = _Worker(process)
        self._hand(ours)

    def _hand(self, pipe: Pipe) -> None:
        """Give a worker its next item, or nothing more to do."""
        worker = self._workers[pipe]
        if not self._waiting:
            del self._workers[pipe]
            pipe.close()
            worker.process.join()
            return
        worker.number, worker.steps = self._waiting.popleft(), 0
        with suppress(OSError):  # it died: it will be heard of
            pipe.send(self.items[worker.number])

    def _hear(self, pipe: Pipe) -> None:
        worker = self._workers[pipe]
        try:
            steps, result = cast("tuple[int, list[Result]]", pipe.recv())
        except (EOFError, OSError):
            del self._workers[pipe]
            pipe.close()
            worker.process.join()
            how = f"its process ended early, with code {worker.process.exitcode} (-9: perhaps for memory)"
            self._finish(worker.number, self.lost(self.items[worker.number], how))
            return
        self._steps += steps - worker.steps
        worker.steps = steps
        if result:
            self._finish(worker.number, result[0])
            self._hand(pipe)
        else:
            self.progress(self._done, self._steps)

    def _finish(self, number: int, result: Result) -> None:
        self._found[number] = result
        self._done += 1
        self.progress(self._done, self._steps)


def _serve(work: Callable[[Any, Watch], Any], pipe: Pipe) -> None:
    """What a worker does until there is nothing more."""
    steps, told, stopping = 0, monotonic(), False

    def watch(now: int) -> bool:
        nonlocal steps, told, stopping
        steps = now
        if monotonic() - told >= _TELL_EVERY and not stopping:
            told = monotonic()
            with suppress(OSError):  # the parent is gone: seen below
                pipe.send((steps, []))
        if not stopping and pipe.poll():  # only a wish to stop can come meanwhile, or the end
            stopping = True
        return stopping

    with suppress(EOFError, OSError):  # the parent needs nothing more
        while not stopping and (item := pipe.recv()) is not None:
            steps = 0
            result = work(item, watch)
            pipe.send((steps, [result]))


@contextmanager
def _apart() -> Generator[None]:
    """What is started meanwhile computes in one thread, and hears of Ctrl-C and SIGTERM from us only.

    Terminals and service managers send these to all processes alike.
    """
    ensure_running()  # else it is started with the first process, and lets the signals through again
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
