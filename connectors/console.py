"""Sink that prints slip events and faults, as text or JSON."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TextIO

from connectors.events import encode, faults, finger_name, slips, timestamp
from operators.batch import Faults, Slips, ms
from operators.checks import check_choice
from operators.errors import OutputClosedError
from operators.ports import Json, Run, Sink


@dataclass(eq=False)
class Console(Sink[Slips | Faults]):
    """Slip events and faults as lines of a stream, coloured on a terminal: time (UTC), fingertip, event.

    >>> import asyncio
    >>> import numpy as np
    >>> time, onset, probability = np.array([5_000_000_000]), np.array([1], np.int8), np.array([0.93])
    >>> asyncio.run(Console().write(Slips(time, onset, time, probability, finger=0)))
    1970-01-01 00:00:05.000  finger 0  slip onset  p 0.93

    With ``format="json"`` each line is a JSON object with the latency in ms if it is known, null for NaN, and
    in replays the name of the recording:

    >>> asyncio.run(Console(format="json").write(Slips(time, onset, time, probability, finger=0)))
    {"time":"1970-01-01T00:00:05.000000000Z","event":"slip_onset","finger":"0","p":0.93}

    Raises:
        ParameterError: if `format` is neither text nor json.
    """

    shared = True  # a parallel replay sorts the lines of all processes

    stream: TextIO | None = field(default=None, repr=False)  # None: sys.stdout
    format: Literal["text", "json"] = "text"
    _run: Run | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        check_choice("Console", "format", self.format, ("text", "json"))

    @property
    def destination(self) -> str:
        """Name of the stream."""
        return str(getattr(self._out, "name", "console"))

    @property
    def _out(self) -> TextIO:
        return self.stream or sys.stdout  # which commands redirect

    async def open(self, run: Run) -> None:
        """Use the clock and the recording name of this run."""
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
                if self.format == "json":
                    details: dict[str, Json] = {"barometer": fault.barometer, "fault": fault.kind}
                    name = f"limit_{change}" if fault.limit else f"fault_{change}"
                    self._print_json(time, batch.finger, name, details)
                else:
                    kind = "range limit" if fault.limit else fault.kind
                    self._print(time, batch.finger, f"barometer {fault.barometer} {kind} {change}", "yellow")
            return
        for slip in slips(batch):
            latency = self._run.latency(slip.time) if self._run else None
            if self.format == "json":
                known: dict[str, Json] = {} if latency is None else {"latency_ms": round(latency / ms, 3)}
                name = "slip_onset" if slip.onset else "slip_end"
                self._print_json(slip.time, batch.finger, name, {"p": slip.probability, **known})
                continue
            text, style = ("slip onset", "bold red") if slip.onset else ("slip end  ", "green")
            late = [] if latency is None else [f"sensor to event {latency / ms:.1f} ms"]
            self._print(slip.time, batch.finger, "  ".join([text, f"p {slip.probability:.2f}", *late]), style)

    def _print_json(self, time: int, finger: int, event: str, details: Mapping[str, Json]) -> None:
        recording = self._run.recording if self._run else None
        source: dict[str, Json] = {} if recording is None else {"recording": recording}
        document = {
            "time": timestamp(time),
            "event": event,
            **source,
            "finger": finger_name(finger),
            **details,
        }
        # one write per line: other processes may print to the same stream
        self._out.write(f"{encode(document).decode()}\n")
        self._out.flush()

    def _print(self, time: int, finger: int, text: str, style: str) -> None:
        line = f"{timestamp(time)[:23].replace('T', ' ')}  finger {finger_name(finger)}  {text}"
        if self._out.isatty():
            from rich.console import Console as Terminal

            Terminal(file=self._out).print(line, style=style, highlight=False, markup=False, soft_wrap=True)
        else:
            print(line, file=self._out, flush=True)
