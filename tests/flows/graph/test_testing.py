import asyncio
import time

import pytest

from flows.graph.testing import check_cuts, run_virtually
from operators import Debounce, Operator, Scores


def test_an_empty_batch_has_no_cuts() -> None:
    check_cuts(Debounce(), Scores.empty())


def test_an_operator_that_depends_on_the_cuts_is_an_error_that_names_the_column() -> None:
    class Centre(Operator[Scores, Scores]):
        def process(self, batch: Scores) -> Scores:
            return Scores(batch.time, batch.probability - batch.probability.mean(), finger=batch.finger)

    with pytest.raises(AssertionError, match="probability"):
        check_cuts(Centre(), Scores.rows(range(20), [k / 20 for k in range(20)]))


def test_calls_in_threads_take_no_virtual_time() -> None:
    async def call_beside_a_sleep() -> tuple[bool, float]:
        call = asyncio.create_task(asyncio.to_thread(time.sleep, 0.05))
        await asyncio.sleep(3600)
        return call.done(), asyncio.get_running_loop().time()

    assert run_virtually(call_beside_a_sleep()) == (True, 3600)
