"""What tests of the page share: rows of streams, and a reader of server-sent events."""

import asyncio
import json
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
from aiohttp import ClientResponse, ClientSession

from operators.batch import Motion, Scores, Slips, Zeroed
from tests.connectors.mqtt.broker_process import PATIENCE


def felt(time: int, *counts: int, finger: int = 0) -> Zeroed:
    """One row; of cells that are not given the first one's count."""
    row = np.array([[*counts, *[counts[0]] * (6 - len(counts))]], np.int16)
    return Zeroed(np.array([time]), row, row, np.ones((1, 6), np.bool_), finger=finger)


def slip(time: int, state: int, finger: int = 0) -> Slips:
    """An onset (1) or an end (0)."""
    at = np.array([time])
    return Slips(at, np.array([state], np.int8), at, np.array([0.9]), finger=finger)


def scored(time: int, probability: float, finger: int = 0) -> Scores:
    """One score."""
    return Scores(np.array([time]), np.array([probability]), finger=finger)


def moved(time: int) -> Motion:
    """One row of the arm at 3 mm/s."""
    at = np.array([time])
    return Motion(at, at, np.array([[0.003, 0.0, 0.0, 0.0, 0.0, 0.0]]), np.zeros((1, 6)))


async def events(response: ClientResponse) -> AsyncIterator[tuple[str, Any]]:
    """Server-sent events as they come: name and document."""
    name = ""
    async for line in response.content:
        field, _, value = line.decode().rstrip("\n").partition(": ")
        if field == "event":
            name = value
        elif field == "data":
            yield name, json.loads(value)


@asynccontextmanager
async def listening(url: str) -> AsyncGenerator[AsyncIterator[tuple[str, Any]]]:
    """What a browser at a page hears."""
    async with (
        asyncio.timeout(PATIENCE),
        ClientSession() as session,
        session.get(f"{url}/stream") as response,
    ):
        assert response.content_type == "text/event-stream"
        yield events(response)
