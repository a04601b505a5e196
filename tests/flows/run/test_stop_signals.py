import asyncio
import os
import signal
from threading import Thread

import pytest

from flows.run.stop_signals import signals_to, stopping


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_who_asks_to_stop_is_heard_and_handlers_are_put_back(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with stopping() as stopped:
        assert not stopped()
        os.kill(os.getpid(), number)
        assert stopped()
    assert signal.getsignal(number) is before


def test_who_asks_twice_ends_the_process() -> None:
    with stopping() as stopped:
        os.kill(os.getpid(), signal.SIGINT)
        assert stopped()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_in_another_thread_nobody_can_ask() -> None:
    heard = list[bool]()

    def run() -> None:
        with stopping() as stopped:
            heard.append(stopped())

    thread = Thread(target=run)
    thread.start()
    thread.join()
    assert heard == [False]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_each_signal_calls_what_is_to_stop_until_it_has(number: signal.Signals) -> None:
    called = asyncio.Semaphore(0)
    with signals_to(called.release):
        for _ in range(2):
            os.kill(os.getpid(), number)
            await called.acquire()
    assert not asyncio.get_running_loop().remove_signal_handler(number), "it is gone already"


def test_in_another_thread_a_signal_calls_nobody() -> None:
    called = list[str]()

    async def run() -> None:
        with signals_to(pytest.fail):
            called.append("nobody")

    thread = Thread(target=asyncio.run, args=[run()])
    thread.start()
    thread.join()
    assert called == ["nobody"]
