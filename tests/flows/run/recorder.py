"""Recordings of random touch and motion."""

import asyncio
from pathlib import Path

import numpy as np

from operators import Motion, Touch, ms, s
from operators.ports import Run
from storage import Dataset

START = 1_700_000_000 * s


class Stopped:
    def now(self) -> int:
        return START

    async def sleep_until(self, time: int) -> None:
        raise AssertionError(time)


class Recorder:
    """Records a session step by step, in parts of 10 s."""

    def __init__(self, root: Path, session: str = "one", seed: int = 0) -> None:
        self.folder = root / "sessions" / session
        self._dataset, self._second = Dataset(root, part_span=10 * s, host="test"), 0
        self._random = np.random.default_rng(seed)
        self._loop = asyncio.new_event_loop()
        run = Run(session, "recorded", Stopped(), START, live=False)
        self._loop.run_until_complete(self._dataset.open(run))

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

        self._loop.run_until_complete(write())

    def close(self) -> Path:
        self._loop.run_until_complete(self._dataset.close())
        self._loop.close()
        return self.folder
