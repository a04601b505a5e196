"""Tasks in parallel: one function over many items, on local processes or on a Dask cluster.

A task is a function of a module and one item, both pickled. It must be repeatable: Dask runs the tasks of a
lost worker again on another one.
"""

import logging
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.resource_tracker import ensure_running
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, Final, Never, TypeVar

from operators.errors import EndpointError, ParameterError, SlipflowError
from operators.extras import require_extra

Item = TypeVar("Item")
Result = TypeVar("Result")

_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # of numpy's libraries
_CONNECT_TIMEOUT: Final = 10  # s
_CHECK_INTERVAL: Final = 2.0  # s, between two looks at a silent cluster
_LOST: Final = "the Dask scheduler was lost: when it is back, repeat the command"


def map_tasks(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    executor: Executor | None = None,
    *,
    progress: Callable[[int, int], object] = lambda _done, _total: None,
    lost: Callable[[Item, str], Result] | None = None,
) -> Generator[Result]:
    """Apply a function to many items and yield the results in the order of the items.

    Closing the generator cancels the tasks that have not started, and ends those in local processes.

    Args:
        work: Function of a module. Its errors are raised here.
        items: Arguments.
        executor: Executor of `workers`; None: this process, which also processes a single item instead of a
            local process.
        progress: Called with the number of finished items and of all items, at the start and whenever one
            finishes.
        lost: Returns the result of an item whose worker died, given the reason; None: raise an error.

    Raises:
        SlipflowError: if a worker died, unless `lost` is given; the message names the item.
        EndpointError: if the scheduler of the cluster was lost.
    """
    progress(0, len(items))
    if executor is None or (len(items) == 1 and isinstance(executor, LocalProcesses)):
        for done, item in enumerate(items, 1):
            result = work(item)
            progress(done, len(items))
            yield result
        return
    finished = SimpleQueue[Future[Result]]()

    def start(item: Item) -> Future[Result]:
        task = executor.submit(work, item)
        task.add_done_callback(finished.put)
        return task

    waiting, done = deque((item, start(item)) for item in items), 0
    try:
        while waiting or done < len(items):  # some finish at the same time
            done += not _died(_next(finished, executor))
            progress(done, len(items))
            while waiting and waiting[0][1].done():
                item, task = waiting.popleft()
                if _died(task) and isinstance(executor, LocalProcesses):  # by this item or by another one
                    executor.shutdown()
                    wait([task := executor.submit(work, item)])  # alone
                    waiting = deque((each, start(each) if _died(task) else task) for each, task in waiting)
                    done += 1
                    progress(done, len(items))
                yield _result(item, task, lost or _raise_lost)
    except BaseException:
        for _, task in waiting:
            task.cancel()
        if isinstance(executor, LocalProcesses):
            executor.shutdown()
        raise


def _next(finished: SimpleQueue[Future[Result]], executor: Executor) -> Future[Result]:
    """Wait for the next task that finishes.

    Raises:
        EndpointError: if the scheduler was lost; Dask never ends a task whose result was on its way then.
    """
    while True:
        try:
            return finished.get(timeout=_CHECK_INTERVAL)
        except Empty:
            if isinstance(executor, DaskWorkers) and executor.is_lost:
                raise EndpointError("--cluster", _LOST) from None


def _died(task: Future[Any]) -> bool:
    """Return whether a task was in progress or waiting when a local process died."""
    return task.done() and not task.cancelled() and isinstance(task.exception(), BrokenProcessPool)


@contextmanager
def workers(jobs: int | None = None, cluster: str | None = None) -> Generator[Executor | None]:
    """Start local processes, or connect to a Dask cluster; yield the executor for `map_tasks`.

    At the end of the block local processes end, also in the middle of a task. Workers of a cluster finish the
    task in progress.

    Args:
        jobs: Number of local processes, each with one thread of numpy's libraries; None: one per core.
            1: this process only, no executor.
        cluster: URL of a Dask scheduler, such as ``tcp://127.0.0.1:8786``; None: local processes.

    Raises:
        ParameterError: if `jobs` is given with `cluster`.
        InputError: if Dask is not installed.
        EndpointError: if the scheduler cannot be reached.
    """
    if cluster is not None:
        if jobs is not None:
            raise ParameterError("workers", "jobs", jobs, "omitted with a cluster, which has its own workers")
        with _cluster(cluster) as executor:
            yield executor
    elif (count := jobs or os.cpu_count() or 1) == 1:
        yield None
    else:
        with LocalProcesses(count) as executor:
            yield executor


class LocalProcesses(Executor):
    """Executor of local processes, which end with this process.

    A process that dies breaks all tasks in progress and waiting: `map_tasks` repeats them.
    """

    def __init__(self, count: int) -> None:
        self._count, self._context = count, get_context("spawn")
        self._pool: ProcessPoolExecutor | None = None
        self._lifeline: Connection[Any, Any] | None = None  # its end here; the processes have the other

    def submit(self, work: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Schedule a task; its future raises `BrokenProcessPool` if a process dies."""
        with _inherited_by_processes():
            if self._pool is None:
                theirs, self._lifeline = self._context.Pipe(duplex=False)
                self._pool = ProcessPoolExecutor(
                    self._count, self._context, initializer=_end_with, initargs=(theirs,)
                )
            try:
                return self._pool.submit(work, *args, **kwargs)
            except BrokenProcessPool as error:
                broken = Future[Result]()
                broken.set_exception(error)
                return broken

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all processes, also in the middle of a task; the next task starts new ones."""
        if self._lifeline and self._pool:
            self._lifeline.close()
            self._pool.shutdown(cancel_futures=True)
        self._lifeline = self._pool = None


@contextmanager
def _inherited_by_processes() -> Generator[None]:
    """Let processes that start in the block ignore signals, and use one thread for numpy's libraries.

    Terminals and service managers send signals to all processes; only the parent must act on them.
    """
    ensure_running()  # else it starts with the first process and unblocks the signals again
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
    unset = [name for name in _THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(unset, "1"))
    try:
        yield
    finally:
        for name in unset:
            del os.environ[name]
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _end_with(lifeline: "Connection[Any, Any]") -> None:
    """End this process when the other end of a pipe closes, which also happens when the parent is killed."""

    def end() -> None:
        lifeline.poll(None)  # the parent sends nothing
        os._exit(1)

    Thread(target=end, daemon=True).start()


class DaskWorkers(Executor):
    """Executor of the workers of a cluster, given a connected client of `distributed`."""

    def __init__(self, client: Any) -> None:
        self._client, self._executor = client, client.get_executor(pure=False)

    def submit(self, work: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Run a function on a worker."""
        task: Future[Result] = self._executor.submit(work, *args, **kwargs)
        return task

    @property
    def is_lost(self) -> bool:
        """Whether the scheduler was lost for good."""
        return bool(self._client.status == "closed")


@contextmanager
def _cluster(url: str) -> Generator[Executor]:
    """Connect to a Dask scheduler; Dask's own settings apply, such as those of TLS."""
    require_extra("cluster", "--cluster")
    distributed: Any = import_module("distributed")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # the errors raised here say what failed
    try:
        distributed.comm.resolve_address(url)  # else a client of a wrong URL takes 20 s to end
        client = distributed.Client(url, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = f"the Dask scheduler cannot be reached: {error}"
        raise EndpointError(url, reason) from error
    try:
        yield DaskWorkers(client)
    finally:
        client.close(timeout=1)


def _result(item: Item, task: Future[Result], lost: Callable[[Item, str], Result]) -> Result:
    try:
        return task.result()
    except BrokenProcessPool:
        return lost(item, "its process died, perhaps for lack of memory")
    except CancelledError:
        raise EndpointError("--cluster", _LOST) from None
    except Exception as error:
        if type(error).__name__ != "KilledWorker":  # of Dask, which is not imported here
            raise
        return lost(item, f"its worker died, and so did those that tried again: {error}")


def _raise_lost(item: object, reason: str) -> Never:
    raise SlipflowError(f"{item}: {reason}")


@contextmanager
def one_thread() -> Generator[None]:
    """Limit torch, if imported, scikit-learn and numpy's libraries to one thread.

    For timing on one core, or for one process per core.
    """
    with ExitStack() as stack:
        if torch := sys.modules.get("torch"):
            stack.callback(torch.set_num_threads, torch.get_num_threads())
            torch.set_num_threads(1)
        if find_spec("sklearn") and find_spec("threadpoolctl"):  # installed together
            import_module("sklearn")  # only loaded thread pools can be limited
            pools: Any = import_module("threadpoolctl")
            stack.enter_context(pools.threadpool_limits(1))
        yield
