"""Fixtures that several test folders share."""

import asyncio
import gc
import logging
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterator
from importlib.util import find_spec
from inspect import iscoroutinefunction, signature
from pathlib import Path

import pytest
from hypothesis import settings

from connectors.mqtt import outbox
from connectors.mqtt.broker_link import Link
from connectors.web.access import TOKEN
from flows.graph.testing import run_virtually
from flows.run.clocks import EventClock
from operators.extras import EXTRAS
from operators.ports import Run
from tests.connectors.mqtt.broker_process import TestBroker
from tests.waiting import PATIENCE

LIMIT = 120.0  # s, for a coroutine

# Subprocesses inherit both. Without bytecode files each of them compiles what it imports; OpenMP threads of
# several processes spin and take the CPU from each other.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
os.environ.setdefault("OMP_NUM_THREADS", "1")
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # a shell ignores it in background jobs
    signal.signal(signal.SIGINT, signal.default_int_handler)

logging.getLogger("slipflow.compilation").setLevel(logging.WARNING)  # any test may be the first that compiles

settings.register_profile("slipflow", deadline=None, max_examples=50)  # no deadline: machines vary in speed
settings.load_profile("slipflow")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Exempt the collected tests from garbage collection, which would visit all of them again and again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run an async test in a new event loop, in virtual time if it is marked so."""
    test = pyfuncitem.obj
    if not iscoroutinefunction(test):
        return None
    given = {name: pyfuncitem.funcargs[name] for name in signature(test).parameters}
    if pyfuncitem.get_closest_marker("virtual"):
        run_virtually(test(**given))
    else:
        asyncio.run(asyncio.wait_for(test(**given), LIMIT))
    return True


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder for state that outlives a run, instead of the user's; the user's token is not used either."""
    monkeypatch.delenv(TOKEN, raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"


@pytest.fixture
def run() -> Run:
    """Run that began 90 s after the start of 1970, 10 s ago."""
    return Run("run1", "live", EventClock(100_000_000_000), 90_000_000_000)


@pytest.fixture
def quiet(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Require that no error is logged, also by asyncio for a callback; the disk of a busy machine is slow."""
    monkeypatch.setattr(outbox, "WRITE_TIMEOUT", PATIENCE)
    yield
    records = [*caplog.get_records("setup"), *caplog.get_records("call")]
    assert not [record for record in records if record.levelno >= logging.ERROR]


@pytest.fixture
def links(monkeypatch: pytest.MonkeyPatch) -> list[Link]:
    """Connections to brokers that are made or attempted."""
    made = list[Link]()
    connect = Link.connect

    async def record_and_connect(self: Link) -> None:
        made.append(self)
        await connect(self)

    monkeypatch.setattr(Link, "connect", record_and_connect)
    return made


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[TestBroker]:
    """Running mosquitto without access control."""
    with TestBroker(tmp_path) as server:
        yield server


@pytest.fixture
def hide_packages(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Function after which packages count as not installed."""

    modules = {each.package: each.module for each in EXTRAS.values()}

    def hide(*packages: str) -> None:
        hidden = {modules.get(package, package) for package in packages}
        where = "operators.extras.find_spec"
        monkeypatch.setattr(where, lambda name: None if name in hidden else find_spec(name))

    return hide
