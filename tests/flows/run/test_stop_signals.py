import asyncio
import os
import signal
import subprocess
import sys
from threading import Thread

import pytest

from flows.run.stop_signals import signal_handlers, signals_to
from tests.waiting import PATIENCE


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_each_signal_calls_stop_within_the_block(number: signal.Signals) -> None:
    called = asyncio.Semaphore(0)
    with signals_to(called.release):
        for _ in range(2):
            os.kill(os.getpid(), number)
            await called.acquire()
    assert not asyncio.get_running_loop().remove_signal_handler(number), "it is gone already"


def test_signals_are_ignored_in_another_thread() -> None:
    called = list[str]()

    async def run() -> None:
        with signals_to(pytest.fail):
            called.append("ignored")

    thread = Thread(target=asyncio.run, args=[run()])
    thread.start()
    thread.join()
    assert called == ["ignored"]


WHILE = """
import asyncio, os, signal
from flows.run.stop_signals import signal_handlers

async def main():
    received = asyncio.Event()
    with signal_handlers({signal.SIGUSR1: received.set}):
        os.kill(os.getpid(), signal.SIGUSR1)
        await received.wait()
    os.kill(os.getpid(), signal.SIGUSR1)

signal.signal(signal.SIGUSR1, signal.SIG_IGN)
asyncio.run(main())
os.kill(os.getpid(), signal.SIGUSR1)
print("alive")
"""


def test_a_signal_is_handled_in_the_block_and_ignored_again_after_it() -> None:
    done = subprocess.run([sys.executable, "-c", WHILE], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "alive\n"), done.stderr


def test_a_loop_that_sleeps_wakes_for_a_signal() -> None:
    async def main() -> None:
        received = asyncio.Event()
        with signal_handlers({signal.SIGUSR2: received.set}):
            sending = Thread(target=signal.raise_signal, args=(signal.SIGUSR2,))
            sending.start()
            async with asyncio.timeout(PATIENCE):
                await received.wait()
            sending.join()

    before = signal.getsignal(signal.SIGUSR2)
    asyncio.run(main())
    assert signal.getsignal(signal.SIGUSR2) == before
