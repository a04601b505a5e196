"""Fixtures that several test folders share."""

import asyncio
import logging
from collections.abc import Iterator
from inspect import iscoroutinefunction, signature
from pathlib import Path

import pytest
from hypothesis import settings

from connectors.mqtt.broker_link import Link
from flows.graph.testing import run_virtually
from operators.ports import Run
from tests.connectors.mqtt.broker_process import TestBroker

LIMIT = 120.0  # s, after which a coroutine hangs

settings.register_profile("slipflow", deadline=None, max_examples=50)  # machines are noisy: no test is timed
settings.load_profile("slipflow")


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine in an event loop of its own, in virtual time if it is so marked."""
    test = pyfuncitem.obj
    if not iscoroutinefunction(test):
        return None
    given = {name: pyfuncitem.funcargs[name] for name in signature(test).parameters}
    if pyfuncitem.get_closest_marker("virtual"):
        run_virtually(test(**given))
    else:
        asyncio.run(asyncio.wait_for(test(**given), LIMIT))
    return True


class SetClock:
    """Shows what it is set to; waiting sets it."""

    def __init__(self, time: int) -> None:
        self.time = time

    def now(self) -> int:
        return self.time

    async def sleep_until(self, time: int) -> None:
        self.time = max(self.time, time)


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of what outlives a run: not the user's."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"


@pytest.fixture
def run() -> Run:
    """A run that began 90 s after the start of 1970, 10 s ago."""
    return Run("run1", "live", SetClock(100_000_000_000), 90_000_000_000)


@pytest.fixture
def quiet(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """Nobody logs an error, nor asyncio what happens in a callback."""
    yield
    records = [*caplog.get_records("setup"), *caplog.get_records("call")]
    assert not [record for record in records if record.levelno >= logging.ERROR]


@pytest.fixture
def links(monkeypatch: pytest.MonkeyPatch) -> list[Link]:
    """The connections to brokers that are made, or tried."""
    made = list[Link]()
    connect = Link.connect

    async def remembered(self: Link) -> None:
        made.append(self)
        await connect(self)

    monkeypatch.setattr(Link, "connect", remembered)
    return made


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[TestBroker]:
    """A running mosquitto that lets everybody do everything."""
    with TestBroker(tmp_path) as server:
        yield server
