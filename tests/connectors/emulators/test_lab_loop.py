import asyncio
import time

import pytest

from connectors.emulators import lab_loop
from connectors.emulators.lab_loop import STEP, run_lab


def test_a_stall_of_the_host_is_no_jump_in_time() -> None:
    async def main() -> float:
        loop = asyncio.get_running_loop()
        begin = loop.time()
        time.sleep(0.5)  # noqa: ASYNC251 - the stall
        for _ in range(3):
            await asyncio.sleep(0)
        return loop.time() - begin

    assert run_lab(main()) <= 5 * STEP


def test_timers_wait_for_their_time() -> None:
    async def main() -> tuple[float, float]:
        loop = asyncio.get_running_loop()
        begin, real = loop.time(), time.monotonic()
        for _ in range(5):
            await asyncio.sleep(0.02)
        return loop.time() - begin, time.monotonic() - real

    passed, real = run_lab(main())
    assert passed >= 0.1
    assert real >= 0.1  # never faster than the host's


def test_time_stands_still_while_it_is_held_and_input_is_handled() -> None:
    async def main() -> float:
        loop, held = asyncio.get_running_loop(), [True]
        assert isinstance(loop, lab_loop.LabLoop)
        await asyncio.sleep(0)
        loop.hold_while(lambda: held[0])
        await asyncio.sleep(0)
        begin = loop.time()

        def release() -> None:
            assert loop.time() == begin
            held.clear()
            held.append(False)

        work = loop.run_in_executor(None, time.sleep, 0.1)
        work.add_done_callback(lambda _: release())
        await asyncio.sleep(0.001)  # ends after the release only
        assert work.done()
        return loop.time() - begin

    assert run_lab(main()) >= 0.001


def test_time_is_not_held_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lab_loop, "PATIENCE", 10)

    async def main() -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, lab_loop.LabLoop)
        loop.hold_while(lambda: True)
        await asyncio.sleep(0.01)

    run_lab(main())
