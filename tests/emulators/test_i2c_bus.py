"""An unmodified smbus2 and the emulated bus."""

from collections.abc import Iterator

import numpy as np
import pytest
from smbus2 import SMBus

from operators.batch import Counts, ms
from tests.emulators.i2c_bus import EmulatedI2cBus, served

PATH = "/dev/i2c-7"
CELL = 0x60
ALL = 0x06


class Bench:
    """A bus with the fingers 0 and 3 at rows 0 and 2, whose time the test sets, and a client."""

    def __init__(self) -> None:
        self.time, self.pressure = 1000, [400, 410, 420, 430, 440, 450]
        self.bus = EmulatedI2cBus(self, {0: 0, 2: 3}, now=lambda: self.time)
        self.client = SMBus()

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        return np.array(self.pressure, np.int16), np.arange(500, 506).astype(np.int16)

    def convert(self) -> None:
        """Convert all cells, as a host does it."""
        self.client.write_quick(ALL)
        self.client.write_i2c_block_data(CELL, 0x12, [1])
        self.client.read_byte(ALL)
        self.time += 3 * ms

    def read(self, address: int) -> tuple[int, int]:
        """Return pressure and temperature of one cell."""
        self.client.write_quick(address)
        b = self.client.read_i2c_block_data(CELL, 0, 4)
        self.client.read_byte(address)
        return (b[0] << 8 | b[1]) >> 6, (b[2] << 8 | b[3]) >> 6


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    with served(bench.bus, PATH), SMBus(PATH) as bench.client:
        yield bench


def test_a_conversion_shows_the_previous_sample_until_it_ends(bench: Bench) -> None:
    assert bench.read(4) == (0, 0)
    bench.convert()
    bench.pressure = [300] * 6
    bench.convert()
    bench.time -= 1
    assert bench.read(4) == (440, 504)
    bench.time += 1
    assert bench.read(4) == (300, 504)


def test_two_connected_cells_answer_together_as_the_logical_and(bench: Bench) -> None:
    bench.pressure[:2] = 372, 223
    bench.convert()
    bench.client.write_quick(0)
    bench.client.write_quick(1)
    b = bench.client.read_i2c_block_data(CELL, 0, 4)
    assert (b[0] << 8 | b[1]) >> 6 == 84
