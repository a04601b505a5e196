"""Rows of streams, and readers of the live page's frames and of the metrics."""

import asyncio
import json
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing, asynccontextmanager
from typing import Any

import numpy as np
from aiohttp import ClientSession, WSMsgType

from connectors import Metrics
from operators.batch import Faults, Motion, Scores, Slips, Zeroed
from operators.health import FaultKind
from operators.ports import Run
from tests.waiting import PATIENCE


def touched(time: int, *counts: int, finger: int = 0) -> Zeroed:
    """Return one row; cells that are not given have the count of the first one."""
    row = np.array([[*counts, *[counts[0]] * (6 - len(counts))]], np.int16)
    return Zeroed(np.array([time]), row, row, np.ones((1, 6), np.bool_), finger=finger)


def slip(time: int, state: int, finger: int = 0) -> Slips:
    """Return an onset (1) or an end (0)."""
    at = np.array([time])
    return Slips(at, np.array([state], np.int8), at, np.array([0.9]), finger=finger)


def scored(time: int, probability: float, finger: int = 0) -> Scores:
    """Return one score."""
    return Scores(np.array([time]), np.array([probability]), finger=finger)


def broken(time: int, cell: int, kind: FaultKind) -> Faults:
    """Return the beginning of a fault of a cell."""
    codes = np.array([cell], np.int8), np.array([kind], np.int8)
    return Faults(np.array([time]), *codes, np.array([True]), finger=0)


def moved(time: int) -> Motion:
    """Return one row of the arm at 3 mm/s."""
    at = np.array([time])
    return Motion(at, at, np.array([[0.003, 0.0, 0.0, 0.0, 0.0, 0.0]]), np.zeros((1, 6)))


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
