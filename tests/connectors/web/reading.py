"""What tests of the page share: rows of streams, and a reader of its messages."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import numpy as np
from aiohttp import ClientConnectionError, ClientSession

from operators.batch import Motion, Scores, Slips, Zeroed
from tests.waiting import PATIENCE


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


async def messages(session: ClientSession, url: str, browser: str = "test") -> AsyncIterator[tuple[str, Any]]:
    """Messages of a live page as a browser gets them, until it ends: name and document."""
    query = {"browser": browser, "session": "", "next": ""}
    with suppress(ClientConnectionError):
        while True:
            async with session.get(f"{url}/messages", params=query) as response:
                assert response.status == 200, await response.text()
                found = await response.json()
            query["next"] = str(found["next"])
            for name, document in found["messages"]:
                if name == "hello":
                    query["session"] = document["session"]
                yield name, document
                if name == "end":
                    return


@asynccontextmanager
async def listening(url: str) -> AsyncGenerator[AsyncIterator[tuple[str, Any]]]:
    """What a browser at a page hears."""
    async with asyncio.timeout(PATIENCE), ClientSession() as session:
        yield messages(session, url)
