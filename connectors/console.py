"""Printing slip events for people."""

import sys
from dataclasses import dataclass, field
from typing import TextIO

from connectors.events import faults, finger_name, timestamp
from operators.batch import SLIP, Faults, Slips, ms
from operators.ports import Run, Sink


@dataclass(eq=False)
class Console(Sink[Slips | Faults]):
    """Prints one line per event to a stream, in colour where that is a terminal: time (UTC), finger, what.

    >>> import asyncio
    >>> import numpy as np
    >>> time, onset, probability = np.array([5_000_000_000]), np.array([1], np.int8), np.array([0.93])
    >>> asyncio.run(Console().write(Slips(time, onset, time, probability, finger=0)))
    1970-01-01 00:00:05.000  finger 0  slip onset  p 0.93
    """

    stream: TextIO = field(default_factory=lambda: sys.stdout, repr=False)
    _run: Run | None = field(default=None, init=False, repr=False)

    @property
    def place(self) -> str:
        """Name of the stream."""
        return str(getattr(self.stream, "name", "console"))

    async def open(self, run: Run) -> None:
        """Tell latencies by the clock of this run."""
        self._run = run

    async def write(self, batch: Slips | Faults) -> None:
        """Print the events of a batch."""
        if isinstance(batch, Faults):
            for time, fault, begins in faults(batch):
                what = f"barometer {fault.barometer} {fault.kind} {'begins' if begins else 'ends'}"
                self._print(time, batch.finger, what, "yellow")
            return
        rows = zip(batch.time.tolist(), batch.state.tolist(), batch.probability.tolist(), strict=True)
        for time, state, probability in rows:
            latency = ""
            if self._run and self._run.live:
                latency = f"  {(self._run.clock.now() - time) / ms:.1f} ms"
            what, style = ("slip onset", "bold red") if state == SLIP else ("slip end  ", "green")
            self._print(time, batch.finger, f"{what}  p {probability:.2f}{latency}", style)

    def _print(self, time: int, finger: int, what: str, style: str) -> None:
        line = f"{timestamp(time)[:23].replace('T', ' ')}  finger {finger_name(finger)}  {what}"
        if self.stream.isatty():
            from rich.console import Console as Terminal  # noqa: PLC0415 - for terminals only

            Terminal(file=self.stream).print(line, style=style, highlight=False, markup=False)
        else:
            print(line, file=self.stream, flush=True)
