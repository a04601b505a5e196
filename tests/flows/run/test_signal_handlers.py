import asyncio
import signal
import subprocess
import sys
from threading import Thread

from flows.run.stop_signals import signal_handlers

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
            async with asyncio.timeout(10):
                await received.wait()
            sending.join()

    before = signal.getsignal(signal.SIGUSR2)
    asyncio.run(main())
    assert signal.getsignal(signal.SIGUSR2) == before


def test_outside_of_the_main_thread_nothing_is_changed() -> None:
    before = signal.getsignal(signal.SIGUSR2)
    seen = list[object]()

    async def main() -> None:
        with signal_handlers({signal.SIGUSR2: lambda: None}):
            seen.append(signal.getsignal(signal.SIGUSR2))

    thread = Thread(target=asyncio.run, args=(main(),))
    thread.start()
    thread.join()
    assert seen == [before]
