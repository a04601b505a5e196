"""Signals, and messages to a service manager, received by a socket like systemd's."""

import asyncio
import os
import signal
import socket
from collections.abc import AsyncIterator, Iterator
from contextlib import suppress
from pathlib import Path
from threading import Thread

import pytest

from flows.graph.testing import TestSink
from flows.run.supervision import ALIVE, READY, STOPPING, notify_systemd, signals_to
from operators import Clock, EndpointError, Scores, s
from tests.flows.run.live import Endless, execute, flow_of, scores


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
async def test_each_signal_calls_stop_in_the_block_and_is_handled_as_before(number: signal.Signals) -> None:
    before, called = signal.getsignal(number), asyncio.Semaphore(0)
    with signals_to(called.release):
        for _ in range(2):
            os.kill(os.getpid(), number)
            await called.acquire()
    assert signal.getsignal(number) is before
    assert not asyncio.get_running_loop().remove_signal_handler(number), "it is gone already"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
async def test_a_signal_that_was_ignored_before_is_ignored_again_after_the_block(
    number: signal.Signals,
) -> None:
    before = signal.signal(number, signal.SIG_IGN)
    try:
        with signals_to(pytest.fail):
            if number == signal.SIGHUP:  # nohup
                os.kill(os.getpid(), number)
                await asyncio.sleep(0.01)
        os.kill(os.getpid(), number)  # would end this process
    finally:
        signal.signal(number, before)


def test_signals_are_left_alone_in_another_thread() -> None:
    async def run() -> None:
        with signals_to(pytest.fail):
            pass

    before = signal.getsignal(signal.SIGTERM)
    thread = Thread(target=asyncio.run, args=[run()])
    thread.start()
    thread.join()
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    path = tmp_path / "notify"
    monkeypatch.setenv("NOTIFY_SOCKET", str(path))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(path))
        listener.setblocking(False)
        yield listener


class Device(Endless):
    """A source that hangs after one row, or fails."""

    def __init__(self, *, fails: bool) -> None:
        self.fails = fails

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        if self.fails:
            raise EndpointError("device", "unplugged")
        yield scores(0, 1)[0]
        await clock.sleep_until(clock.now() + 3600 * s)


@pytest.mark.parametrize(("fails", "fed"), [(True, 9), (False, 5)])  # of 9: silent from 5 s on
def test_a_run_is_ready_and_stops_and_the_watchdog_starves_only_while_a_source_hangs(
    manager: socket.socket, *, fails: bool, fed: int
) -> None:
    execute(flow_of(Device(fails=fails), TestSink()), duration=9 * s)
    found = list[str]()
    with suppress(BlockingIOError):
        while True:
            found.append(manager.recv(100).decode())
    assert found == [READY, *[ALIVE] * fed, STOPPING]


@pytest.mark.parametrize("address", ["", "relative", "/nobody/listens"])
def test_a_missing_manager_is_no_error(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    notify_systemd(READY)
