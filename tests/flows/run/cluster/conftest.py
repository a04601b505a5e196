"""A flow with a join and two derived streams, and recordings for it."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from flows.graph import Flow
from flows.graph.testing import TestSource
from operators import Align, Debounce, Label, Motion, Score, Touch, Zero, ms, s
from operators.ports import Run
from storage import Dataset, load_detector

START = 1_700_000_000 * s


class Stopped:
    def now(self) -> int:
        return START

    async def sleep_until(self, time: int) -> None:
        raise AssertionError(time)


class Recorder:
    """Records a session step by step, in parts of 10 s."""

    def __init__(self, root: Path, session: str = "one") -> None:
        self.folder = root / "sessions" / session
        self._dataset, self._second = Dataset(root, part_span=10 * s, host="test"), 0
        self._random = np.random.default_rng(0)
        asyncio.run(self._dataset.open(Run(session, "recorded", Stopped(), START, live=False)))

    def record(self, seconds: int, fingers: tuple[int, ...] = (0, 1)) -> None:
        async def write() -> None:
            for _ in range(seconds):
                begin = START + self._second * s
                for finger in fingers:
                    time = begin + finger + np.arange(100) * 10 * ms
                    counts = self._random.integers(200, 500, (100, 6)).astype(np.int16)
                    valid = np.ones((100, 6), np.bool_)
                    await self._dataset.write(Touch(time, counts, counts, valid, finger=finger))
                time = begin + 3 * ms + np.arange(125) * 8 * ms
                velocity = self._random.normal(0, 0.01, (125, 6))
                await self._dataset.write(Motion(time, time, velocity, np.full((125, 6), np.nan)))
                self._second += 1

        asyncio.run(write())

    def close(self) -> Path:
        asyncio.run(self._dataset.close())
        return self.folder


@pytest.fixture
def new_recorder(tmp_path: Path) -> Callable[..., Recorder]:
    def build(session: str = "one") -> Recorder:
        return Recorder(tmp_path / "source", session)

    return build


@pytest.fixture
def folder(new_recorder: Callable[..., Recorder]) -> Path:
    """A session with two fingertips and 45 s."""
    recorder = new_recorder()
    recorder.record(45)
    return recorder.close()


def derive(out: Path, threshold: float = 0.5) -> Flow:
    """Declare a flow that stores raw touch, samples and slips."""
    flow, dataset = Flow("derive"), Dataset(out, part_span=15 * s, host="test")
    touch = flow.source(TestSource(Touch))
    zeroed = touch | Zero()
    (zeroed & flow.source(TestSource(Motion)) | Align() | Label(delay=70 * ms)).to(dataset)
    (zeroed | Score(load_detector("psd")) | Debounce(threshold=threshold)).to(dataset)
    touch.to(dataset)
    return flow
