"""Sink that prints slip events and faults."""

import sys
from dataclasses import dataclass, field

from connectors.events import faults, finger_name, slips, timestamp
from operators.batch import Faults, Slips, ms
from operators.errors import OutputClosedError
from operators.ports import Run, Sink


@dataclass(eq=False)
class Console(Sink[Slips | Faults]):
    """Slip events and faults as printed lines: time (UTC), fingertip, event.

    >>> import asyncio
    >>> import numpy as np
    >>> time, onset, probability = np.array([5_000_000_000]), np.array([1], np.int8), np.array([0.93])
    >>> asyncio.run(Console().write(Slips(time, onset, time, probability, finger=0)))
    1970-01-01 00:00:05.000  finger 0  slip onset  p 0.93
    """

    shared = True  # a parallel replay sorts the lines of all processes

    _run: Run | None = field(default=None, init=False, repr=False)

    @property
    def destination(self) -> str:
        """Name of the stream."""
        return str(getattr(sys.stdout, "name", "console"))

    async def open(self, run: Run) -> None:
        """Use the clock of this run."""
        self._run = run

    def take(self, batch: Slips | Faults) -> bool:
        """Print the events of a batch.

        Raises:
            OutputClosedError: if the reader of the stream has gone.
        """
        try:
            self._print_events(batch)
        except BrokenPipeError:
            raise OutputClosedError(self.destination, "was closed") from None
        return True

    def _print_events(self, batch: Slips | Faults) -> None:
        if isinstance(batch, Faults):
            for time, fault, begins in faults(batch):
                kind, change = "range limit" if fault.limit else fault.kind, "begins" if begins else "ends"
                _print(time, batch.finger, f"barometer {fault.barometer} {kind} {change}")
            return
        for slip in slips(batch):
            text = f"slip {'onset' if slip.onset else 'end  '}  p {slip.probability:.2f}"
            if self._run and (latency := self._run.latency(slip.time)) is not None:
                text += f"  sensor to event {latency / ms:.1f} ms"
            _print(slip.time, batch.finger, text)


def _print(time: int, finger: int, text: str) -> None:
    line = f"{timestamp(time)[:23].replace('T', ' ')}  finger {finger_name(finger)}  {text}\n"
    if sys.stdout:  # else the output is closed
        sys.stdout.write(line)  # one write per line: other processes may print to the same stream
        sys.stdout.flush()
