import asyncio
import time

from flows.graph.testing import run_virtually
from flows.run.clocks import LoopClock
from operators import s


def test_a_paced_clock_runs_at_its_pace() -> None:
    async def main() -> tuple[float, int]:
        clock = LoopClock(start=0, pace=10)
        await clock.sleep_until(50 * s)
        return asyncio.get_running_loop().time(), clock.now()

    assert run_virtually(main()) == (5.0, 50 * s)


def test_calls_in_threads_take_no_virtual_time() -> None:
    async def call_beside_a_sleep() -> tuple[bool, float]:
        call = asyncio.create_task(asyncio.to_thread(time.sleep, 0.05))
        await asyncio.sleep(3600)
        return call.done(), asyncio.get_running_loop().time()

    assert run_virtually(call_beside_a_sleep()) == (True, 3600)
