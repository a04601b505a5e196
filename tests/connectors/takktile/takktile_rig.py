"""Emulated bus with fingertips whose counts are known, behind an unmodified smbus2."""

from collections.abc import Callable

import numpy as np

from operators.batch import Counts, us
from tests.emulators.i2c_bus import EmulatedI2cBus

PATH = "/dev/i2c-1"


class Skin:
    """Counts that depend on finger, cell and conversion; functions can be called at given conversions."""

    def __init__(self) -> None:
        self.conversions = 0  # of all fingertips together
        self.then: dict[int, Callable[[], None]] = {}  # by number of the conversion
        self._time = 0

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        if time != self._time:
            self._time, self.conversions = time, self.conversions + 1
            if happen := self.then.get(self.conversions):
                happen()
        return self.pressure(finger, self.conversions), self.temperature(finger)

    def pressure(self, finger: int, conversion: int) -> Counts:
        cells = 300 + 13 * finger + 31 * np.arange(6) + conversion % 11
        return cells.astype(np.int16)

    def temperature(self, finger: int) -> Counts:
        return (480 + 5 * finger + 3 * np.arange(6)).astype(np.int16)


class Bus(EmulatedI2cBus):
    """Bus whose fingertips, given by row, convert fast."""

    def __init__(self, fingers: dict[int, int]) -> None:
        self.skin = Skin()
        super().__init__(self.skin, fingers, conversion=50 * us)
