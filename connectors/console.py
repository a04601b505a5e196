"""Sink that prints slip events and faults, as text or JSON."""

import sys
from dataclasses import dataclass, field
from typing import Literal

from connectors.events import encode, faults, finger_name, slips, timestamp
from operators.batch import Faults, Slips, ms
from operators.checks import check_choice
from operators.errors import OutputClosedError
from operators.ports import Json, Run, Sink


@dataclass(eq=False)
class Console(Sink[Slips | Faults]):
    """Slip events and faults as printed lines, coloured on a terminal: time (UTC), fingertip, event.

    >>> import asyncio
    >>> import numpy as np
    >>> time, onset, probability = np.array([5_000_000_000]), np.array([1], np.int8), np.array([0.93])
    >>> asyncio.run(Console().write(Slips(time, onset, time, probability, finger=0)))
    1970-01-01 00:00:05.000  finger 0  slip onset  p 0.93

    With ``format="json"`` each line is a JSON object, with the latency in ms if it is known; NaN is null:

    >>> asyncio.run(Console(format="json").write(Slips(time, onset, time, probability, finger=0)))
    {"time":"1970-01-01T00:00:05.000000000Z","event":"slip_onset","finger":"0","p":0.93}

    Raises:
        ParameterError: if `format` is neither text nor json.
    """

    shared = True  # a parallel replay sorts the lines of all processes

    format: Literal["text", "json"] = "text"
    _run: Run | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        check_choice("Console", "format", self.format, ("text", "json"))

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
                change = "begins" if begins else "ends"
                event = f"{'limit' if fault.limit else 'fault'}_{change}"
                details: dict[str, Json] = {"barometer": fault.barometer, "fault": fault.kind}
                text = f"barometer {fault.barometer} {'range limit' if fault.limit else fault.kind} {change}"
                self._print(time, batch.finger, event, details, text, "yellow")
            return
        for slip in slips(batch):
            event, style = ("slip_onset", "bold red") if slip.onset else ("slip_end", "green")
            details = {"p": slip.probability}
            text = f"{event.replace('_', ' '):10}  p {slip.probability:.2f}"
            if self._run and (latency := self._run.latency(slip.time)) is not None:
                details["latency_ms"] = round(latency / ms, 3)
                text += f"  sensor to event {latency / ms:.1f} ms"
            self._print(slip.time, batch.finger, event, details, text, style)

    def _print(
        self, time: int, finger: int, event: str, details: dict[str, Json], text: str, style: str
    ) -> None:
        when, which, out = timestamp(time), finger_name(finger), sys.stdout  # which commands redirect
        if self.format == "json":
            line = encode({"time": when, "event": event, "finger": which, **details}).decode()
        else:
            line = f"{when[:23].replace('T', ' ')}  finger {which}  {text}"
        if self.format == "text" and out.isatty():
            from rich.console import Console as Terminal

            Terminal(file=out).print(line, style=style, highlight=False, markup=False, soft_wrap=True)
        else:
            out.write(f"{line}\n")  # one write per line: other processes may print to the same stream
            out.flush()
