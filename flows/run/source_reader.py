"""Reading of a source in a live run: restarts after failures, gaps, and silence."""

import asyncio
import logging
from collections import defaultdict
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable
from math import inf
from typing import Any, Final, TypeAlias, cast

import numpy as np

from flows.graph.node import location
from flows.run.failures import MISTAKES, contained, reason_of
from operators.batch import Batch, Times, concat, s
from operators.errors import BatchError, EndpointError, OperatorError, SlipflowError
from operators.operator import LateRowFilter
from operators.ports import BackOff, Gap, Run, Source, SourceStatus

Take: TypeAlias = Callable[[Batch], Awaitable[bool] | None]
STRAY: Final = 1 * s  # ns; a row that is further ahead than those before it is dropped
AHEAD: Final = 60 * s  # ns; rows further ahead of the run's clock have the time of another clock
BEHIND: Final = 3600 * s  # ns; so have rows that are older than the start of the run by more than this

log = logging.getLogger("slipflow")


class SourceReader:
    """Reader of one source, which restarts it after each failure.

    A time without rows, because the source failed or was silent for `Source.stale_after`, is recorded as a
    gap. Late rows do not count. A row with a time in the future would make the rows after it late: it waits
    for the next batch, and is dropped and counted as late unless that batch continues after it.

    Args:
        name: Name of the source in the run.
        source: Source to read.
        run: Run that the source belongs to; its status is added.
    """

    def __init__(self, name: str, source: Source[Any], run: Run) -> None:
        self.name, self._source, self._run = name, source, run
        self._kind = cast("type[Batch]", source.kind)
        rate = _declared_rate(source)  # rows per second of each fingertip
        self._period = s / rate if rate else inf  # ns
        declared = rate * len(source.fingers) if rate else None
        self.status = run.sources[name] = SourceStatus(declared_rate=declared)
        self._filters = defaultdict[int, LateRowFilter](LateRowFilter)  # by fingertip; they only count
        self._ahead = defaultdict[int, int](int)  # ns, lead of rows over the run's clock, by fingertip
        self._held = dict[int, Batch]()  # rows of the future, until the next batch, by fingertip
        self._gap_start, self._gap_reason = 0, ""  # of the current gap; 0: none
        self._used = self._late = 0  # rows in time, and late rows, when a check last found new rows in time
        self._silent = 0.0  # s since then
        self._retry = BackOff()
        self._ended = self._warned = self._strayed = self._taking = False

    async def read(self, take: Take) -> None:
        """Pass the batches of the source on until it ends.

        Args:
            take: Called with each batch. It returns None, or what to wait for: then False ends the reading.

        Raises:
            OperatorError: if a batch does not have the type or shape that the source declares, or the source
                raises one of `MISTAKES`.
            SlipflowError: if the source or `take` raises one other than EndpointError.
        """
        try:
            while True:
                if await self._read_once(take):
                    return
                await asyncio.sleep(self._retry.delay())
        finally:
            self._ended, self.status.up = True, False

    async def _read_once(self, take: Take) -> bool:
        """Open the source and read it until it ends; return False if it failed and is to be opened again."""
        stream = self._source.batches(self._run.clock)
        try:
            with contained():
                await self._pass_on(stream, take)
        except Exception as error:
            if (task := asyncio.current_task()) and task.cancelling():  # it replaced the cancellation
                log.warning("%s failed to close: %s", self.name, reason_of(error))
                raise asyncio.CancelledError from error
            if self._taking:  # an operator or a sink failed, not the source
                raise
            if isinstance(error, MISTAKES):
                self.status.error = reason_of(error) + location(self._source, error)
                raise OperatorError(self._run.flow, self.name, self.status.error) from error
            if isinstance(error, SlipflowError) and not isinstance(error, EndpointError):
                self.status.error = str(error)
                raise  # it would fail again
            self._failed(reason_of(error))
            return False
        finally:
            if isinstance(stream, AsyncGenerator):  # release the device before it is opened again
                await self._close(stream)
        return True

    async def _close(self, stream: AsyncGenerator[Batch]) -> None:
        """Close a stream; an error is only logged, because all rows have been passed on."""
        try:
            with contained():
                await stream.aclose()
        except Exception as error:  # noqa: BLE001 - any error of the source's code
            log.warning("%s failed to close: %s", self.name, reason_of(error))

    async def _pass_on(self, stream: AsyncIterator[Batch], take: Take) -> None:
        async for delivered in stream:
            if not len(batch := self._checked(delivered)):
                await asyncio.sleep(0)  # else a source without rows could block the run
            elif not await self._taken(batch, take):
                return
        for batch in self._held.values():  # no batch came after them
            await self._taken(batch, take)

    async def _taken(self, batch: Batch, take: Take) -> bool:
        self._taking = True
        later = take(batch)
        self._taking = later is not None and not await later  # so it stays true at the end of the run
        return not self._taking

    def check(self, waited: float) -> None:
        """Check the times of the rows, and whether the source is silent; call this every `waited` seconds.

        The checks are counted, not the time, so that a stall of the host does not count as silence.
        """
        self._check_times()
        limit, status = self._source.stale_after, self.status
        if limit is None or status.error or self._ended:
            return
        if (used := status.rows - status.late) > self._used:
            self._used, self._late, self._silent = used, status.late, 0.0
            return
        self._silent += waited
        if self._silent * s >= limit and status.late > self._late:
            hint = "its clock was set back, or a row was of the future"
            self._is_silent(f"delivered only late rows for {self._silent:g} s", hint)
        elif self._silent * s >= limit:
            self._is_silent(f"delivered no rows for {self._silent:g} s")

    def end(self) -> None:
        """End the current gap at the end of the run; a source that never delivered a row has failed."""
        self._check_times()
        status = self.status
        if not (status.rows or status.error or self._taking) and self._source.stale_after is not None:
            self._is_silent("never delivered a row")
        if self._gap_start:
            self._end_gap()

    def _check_times(self) -> None:
        """Warn once if the source stamps its rows in another clock; those of a recording may be old."""
        ahead = self.status.newest - self._run.clock.now()  # ns
        plausible = ahead <= AHEAD and self.status.newest >= self._run.start - BEHIND
        if plausible or self._warned or not self.status.rows or not self._source.in_run_time:
            return
        self._warned = True
        distance = f"{abs(ahead) / s:,.0f} s {'in the future' if ahead > 0 else 'ago'}"
        text = "%s delivered rows of %s: time must be ns of the run's clock"
        log.warning(text, self.name, distance)

    def _checked(self, batch: object) -> Batch:
        if not isinstance(batch, self._kind):
            reason = f"yielded {type(batch).__name__}, but declares {self._kind.__name__}"
            raise OperatorError(self._run.flow, self.name, reason)
        try:
            batch.check()
            if not self._source.recording:  # recordings keep late rows
                batch.check_order()
        except BatchError as error:
            raise OperatorError(self._run.flow, self.name, f"yielded {error}") from error
        return self._without_stray(batch) if self._source.in_run_time and len(batch) else batch

    def _without_stray(self, batch: Batch) -> Batch:
        """Hold rows of the future back; deliver them with the next batch if that continues after them."""
        finger, newest, now = batch.finger, batch.time.item(-1), self._run.clock.now()
        if held := self._held.pop(finger, None):
            if held.time[-1] <= batch.time[0]:  # the clock is that of another host
                self._ahead[finger] = newest - now
                return concat(type(batch), [held, batch])
            self.status.rows += len(held)
            self.status.late += len(held)
            if not self._strayed:
                text = "%s delivered a row of %.1f s in the future: such rows are dropped and counted as late"
                log.warning(text, self.name, (held.time.item(-1) - now) / s)
            self._strayed = True
        limit = now + self._ahead[finger] + STRAY
        if newest > limit:
            cut = int(batch.time.searchsorted(limit, side="right"))
            self._held[finger] = batch[cut:]
            return batch[:cut]
        self._ahead[finger] = max(self._ahead[finger], newest - now)
        return batch

    def count(self, batch: Batch) -> None:
        """Count the rows of a batch; call this after passing it on, so that counting delays no event."""
        status, in_time = self.status, self._filters[batch.finger]
        status.missing += missing_rows(batch.time, in_time.newest, self._period)
        if count_rows(status, in_time, batch):
            if self._gap_start:
                self._end_gap()
                log.info("%s works again", self.name)
                self._retry.reset()
            status.up, status.stale, status.error = True, False, ""

    def _failed(self, reason: str) -> None:
        if self.status.stale or not self.status.error:
            log.warning("%s failed, retrying: %s", self.name, reason)
        self.status.failures += 1
        self._ahead.clear()  # a device that restarts may have set its clock
        self._begin_gap(reason, stale=False)

    def _is_silent(self, reason: str, hint: str = "check that it is connected and switched on") -> None:
        log.warning("%s %s: %s", self.name, reason, hint)
        self._begin_gap(reason, stale=True)

    def _begin_gap(self, reason: str, *, stale: bool) -> None:
        self.status.up, self.status.stale, self.status.error = False, stale, reason
        if not self._gap_start:
            now, newest = self._run.clock.now(), self.status.newest or self._run.start
            self._gap_start = newest if newest <= now else now - round(self._silent * s)
            self._gap_reason = reason

    def _end_gap(self) -> None:
        self.status.gaps.append(Gap(self._gap_start, self._run.clock.now(), self._gap_reason))
        self._gap_start = 0


def count_rows(status: SourceStatus, in_time: LateRowFilter, batch: Batch) -> int:
    """Count the rows of a batch of one fingertip, whose filter only counts; return how many are not late."""
    used = len(in_time.filter(batch))
    status.late += len(batch) - used
    status.newest = max(status.newest, in_time.newest)
    status.rows += len(batch)
    return used


def missing_rows(time: Times, before: int, period: float) -> int:
    """Return how many rows are missing in the pauses of a stream: those of 1.5 periods and more.

    Args:
        time: (n,) ns, of the next rows of one fingertip.
        before: Time of the row before them, ns; a negative one: there is none.
        period: Time from one row to the next, ns.

    >>> missing_rows(np.array([20, 30, 60]), 10, 10.0)
    2
    """
    if time.size == 1:
        return max(round((time.item(0) - before) / period) - 1, 0) if before >= 0 else 0
    pauses = np.diff(time, prepend=before if before >= 0 else time[0])
    return int(np.maximum(np.rint(pauses / period) - 1, 0).sum())


def _declared_rate(source: Source[Any]) -> float | None:
    """Return the declared rate of a source, Hz, of each of its fingertips; None: unknown."""
    if source.fingertip is not None:
        return source.fingertip.rate
    rate = source.describe().get("rate_hz")
    return float(rate) if isinstance(rate, int | float) and rate > 0 else None
