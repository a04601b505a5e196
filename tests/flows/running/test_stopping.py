import os
import signal
from threading import Thread

import pytest

from flows.running.stopping import stopping


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
