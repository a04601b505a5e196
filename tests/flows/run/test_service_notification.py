"""Messages to a service manager, received by a socket like systemd's."""

import socket
from collections.abc import AsyncIterator, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from flows.graph import Flow
from flows.graph.testing import TestSink, run_virtually
from flows.run.live_runner import LiveRunner
from flows.run.service_notification import ALIVE, READY, STOPPING, notify_systemd
from operators import Clock, EndpointError, Scores, Source, s
from tests.flows.run.live import scores


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    path = tmp_path / "notify"
    monkeypatch.setenv("NOTIFY_SOCKET", str(path))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(path))
        listener.setblocking(False)  # noqa: FBT003 - socket's signature
        yield listener


def received(listener: socket.socket) -> list[str]:
    found = list[str]()
    with suppress(BlockingIOError):
        while True:
            found.append(listener.recv(100).decode())
    return found


class Device(Source[Scores]):
    """A source that hangs after one row, or fails."""

    def __init__(self, *, fails: bool = False) -> None:
        self.fails = fails

    @property
    def kind(self) -> type[Scores]:
        return Scores

    async def batches(self, clock: Clock) -> AsyncIterator[Scores]:
        if self.fails:
            raise EndpointError("device", "unplugged")
        yield scores(0, 1)[0]
        await clock.sleep_until(clock.now() + 3600 * s)


def messages(device: Device, manager: socket.socket) -> list[str]:
    flow = Flow("f")
    flow.source(device).to(TestSink())

    async def main() -> None:
        await LiveRunner(flow, "run", duration=9 * s).execute()

    run_virtually(main())
    return received(manager)


def test_a_run_reports_ready_first_and_stopping_last(manager: socket.socket) -> None:
    found = messages(Device(fails=True), manager)
    assert (found[0], found[-1]) == (READY, STOPPING)


def test_the_watchdog_starves_while_a_source_hangs(manager: socket.socket) -> None:
    assert messages(Device(), manager).count(ALIVE) == 5  # of 9: silent from 5 s on


def test_the_watchdog_is_fed_while_a_source_reports_failures(manager: socket.socket) -> None:
    assert messages(Device(fails=True), manager).count(ALIVE) == 9


@pytest.mark.parametrize("address", ["", "relative", "/nobody/listens"])
def test_a_missing_manager_is_no_error(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    notify_systemd(READY)
