"""Rows of streams, and readers of the live page's frames and of the metrics."""

import asyncio
import json
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing, asynccontextmanager
from typing import Any

from aiohttp import ClientSession, WSMsgType

from connectors import Metrics
from operators.batch import Faults, Motion, Scores, Slips, Zeroed
from operators.health import FaultKind
from operators.ports import Run
from tests.waiting import PATIENCE


def touched(time: int, *counts: int, finger: int = 0) -> Zeroed:
    """Return one row; cells that are not given have the count of the first one."""
    row = [[*counts, *[counts[0]] * (6 - len(counts))]]
    return Zeroed.rows([time], row, row, True, finger=finger)


def slip(time: int, state: int, finger: int = 0) -> Slips:
    """Return an onset (1) or an end (0)."""
    return Slips.rows([time], state, time, 0.9, finger=finger)


def scored(time: int, probability: float, finger: int = 0) -> Scores:
    """Return one score."""
    return Scores.rows([time], probability, finger=finger)


def fault(time: int, cell: int, kind: FaultKind, *, begins: bool = True, finger: int = 0) -> Faults:
    """Return the beginning or the end of a fault of a cell."""
    return Faults.rows([time], cell, kind, begins, finger=finger)


def moved(time: int) -> Motion:
    """Return one row of the arm at 3 mm/s."""
    return Motion.rows([time], time, [0.003, 0, 0, 0, 0, 0], 0)


async def frames(session: ClientSession, url: str) -> AsyncGenerator[dict[str, Any]]:
    """Yield the frames of a live page until it ends."""
    async with session.ws_connect(f"{url}/live", origin=url) as socket:
        while not socket.closed:
            await socket.send_str("")
            message = await socket.receive()
            if message.type is not WSMsgType.TEXT:
                return
            yield json.loads(message.data)


@asynccontextmanager
async def listening(url: str, within: float = PATIENCE) -> AsyncGenerator[AsyncIterator[dict[str, Any]]]:
    """Read the frames of a page as a browser does, for some seconds at most."""
    async with asyncio.timeout(within), ClientSession() as session, aclosing(frames(session, url)) as found:
        yield found


async def served(run: Run, *batches: Slips | Scores | Faults) -> str:
    """Return the metrics of a run after some batches."""
    metrics = Metrics(0)
    await metrics.open(run)
    for batch in batches:
        await metrics.write(batch)
    async with ClientSession() as session, session.get(metrics.url) as response:
        text = await response.text()
    await metrics.close()
    return text
