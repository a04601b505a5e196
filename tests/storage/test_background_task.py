import asyncio
import logging
import re
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from operators import EndpointError
from storage.background_task import BackgroundTask

LINE = r" \(test_background_task\.py:\d+\)$"


async def fail() -> None:
    await asyncio.sleep(1.0)
    raise KeyError("planted")


async def wait_for_cancelled() -> None:
    future = asyncio.get_running_loop().create_future()
    asyncio.get_running_loop().call_later(1.0, future.cancel)
    await future


async def end_early() -> None:
    await asyncio.sleep(1.0)


async def work_on() -> None:
    await asyncio.Event().wait()


@pytest.mark.virtual
@pytest.mark.parametrize(
    ("work", "reason"),
    [
        (fail, rf"KeyError: 'planted'{LINE}"),
        (wait_for_cancelled, "a task that it awaited was cancelled$"),
        (end_early, "it ended early$"),
    ],
)
async def test_a_failure_is_logged_at_once_and_raised_by_check(
    work: Callable[[], Coroutine[Any, Any, None]], reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    reasons = list[str]()
    task = BackgroundTask("device", "the reading", work(), reasons.append)
    task.check()
    await asyncio.sleep(1.1)
    [record] = caplog.records
    assert record.levelno == logging.ERROR
    assert re.search(rf"^device: the reading has failed: {reason}", record.message)
    assert record.message == f"device: {reasons[0]}"
    await task.end()
    with pytest.raises(EndpointError, match="the reading has failed") as caught:
        task.check()
    assert isinstance(caught.value.__cause__, KeyError) == (work is fail)


@pytest.mark.virtual
async def test_the_end_of_a_task_is_no_failure(caplog: pytest.LogCaptureFixture) -> None:
    once = BackgroundTask("device", "the reading", end_early(), endless=False)
    ended, returned = (BackgroundTask("device", "the reading", work()) for work in (work_on, end_early))
    await ended.end()
    await returned.end(2.0)
    await once.end(None)
    for task in (once, ended, returned):
        assert task.done
        task.check()
    assert asyncio.get_running_loop().time() == pytest.approx(1.0)
    assert not caplog.records
