"""An unmodified smbus2 talks to the emulated bus."""

import errno
import fcntl
import os
from collections.abc import Callable, Iterator
from threading import Thread
from typing import Any

import numpy as np
import pytest
import smbus2.smbus2
from smbus2 import I2cFunc, SMBus, i2c_msg

from operators.batch import Counts, ms
from operators.errors import ParameterError
from tests.connectors.emulators.faulty_i2c import DESIGNWARE, RASPBERRY_PI, Adapter, Defect, FaultyI2cBus
from tests.connectors.emulators.i2c_device import served

PATH = "/dev/i2c-7"
CELL = 0x60
ALL = 0x06


class Skin:
    """Each cell of each finger reads what it is set to, at a temperature of its own."""

    def __init__(self) -> None:
        self.pressure: dict[int, list[int]] = {
            finger: [400 + 10 * k for k in range(6)] for finger in range(4)
        }
        self.asked: list[tuple[int, int]] = []

    def touch(self, finger: int, time: int) -> tuple[Counts, Counts]:
        self.asked.append((finger, time))
        return np.array(self.pressure[finger], np.int16), np.arange(500, 506).astype(np.int16)


class Rig:
    """A bus with the time in one's hand, and a client."""

    def __init__(self, rows: dict[int, int], adapter: Adapter) -> None:
        self.time = 1000
        self.skin = Skin()
        self.bus = FaultyI2cBus(self.skin, rows, adapter=adapter, now=lambda: self.time)
        self.client = SMBus()

    def convert(self) -> None:
        """All cells, as a host does it."""
        self.client.write_quick(ALL)
        self.client.write_i2c_block_data(CELL, 0x12, [1])
        self.client.read_byte(ALL)
        self.time += 3 * ms

    def read(self, address: int) -> tuple[int, int]:
        """Pressure and temperature of one cell."""
        self.client.write_quick(address)
        b = self.client.read_i2c_block_data(CELL, 0, 4)
        self.client.read_byte(address)
        return (b[0] << 8 | b[1]) >> 6, (b[2] << 8 | b[3]) >> 6


@pytest.fixture
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    """With fingers 0 and 3 at rows 0 and 2, on a Raspberry Pi or on the adapter that is asked for."""
    rig = Rig({0: 0, 2: 3}, getattr(request, "param", RASPBERRY_PI))
    with served(rig.bus, PATH), SMBus(PATH) as rig.client:
        yield rig


def refused(number: int, call: Callable[..., object], *arguments: object) -> None:
    with pytest.raises(OSError, match=os.strerror(number)) as raised:
        call(*arguments)
    assert raised.value.errno == number


def test_after_power_up_all_barometers_are_off(rig: Rig) -> None:
    refused(121, rig.client.read_byte, CELL)
    refused(121, rig.client.write_i2c_block_data, CELL, 0x12, [1])


def test_a_write_to_its_address_connects_a_barometer_and_a_read_disconnects_it(rig: Rig) -> None:
    rig.client.write_quick(2 << 3 | 5)
    rig.client.read_byte(CELL)
    assert rig.client.read_byte(2 << 3 | 5) == 0xFF
    refused(121, rig.client.read_byte, CELL)


def test_column_6_means_all_cells_of_a_row_and_of_row_0_all_there_are(rig: Rig) -> None:
    rig.client.write_quick(2 << 3 | 6)
    assert [len(tip.connected) for tip in rig.bus.fingertips.values()] == [0, 6]
    rig.client.write_quick(ALL)
    assert [len(tip.connected) for tip in rig.bus.fingertips.values()] == [6, 6]
    rig.client.read_byte(ALL)
    assert [len(tip.connected) for tip in rig.bus.fingertips.values()] == [0, 0]


@pytest.mark.parametrize("address", [1 << 3, 2 << 3 | 7, 0x61, 0x7F])
def test_nobody_answers_where_nobody_is(rig: Rig, address: int) -> None:
    refused(121, rig.client.write_quick, address)


def test_a_data_byte_to_an_attiny_is_refused_though_the_select_took_effect(rig: Rig) -> None:
    refused(121, rig.client.write_byte, 3, 0)
    assert rig.client.read_byte_data(CELL, 0x04) == 0x3E


def test_the_coefficients_are_the_datasheets_with_an_a0_of_its_own_for_each_cell(rig: Rig) -> None:
    for cell, a0 in ((0, 0x3ECE), (3, 0x3ECE + 24)):
        rig.client.write_quick(cell)
        found = bytes(rig.client.read_i2c_block_data(CELL, 0x04, 8))
        assert found == a0.to_bytes(2, "big") + bytes.fromhex("B3F9 C517 33C8")
        rig.client.read_byte(cell)


def test_a_conversion_takes_its_time_and_shows_the_previous_sample_until_then(rig: Rig) -> None:
    assert rig.read(4) == (0, 0)
    rig.convert()
    assert rig.read(4) == (440, 504)
    rig.skin.pressure[0] = [300] * 6
    rig.client.write_quick(ALL)
    rig.client.write_i2c_block_data(CELL, 0x12, [1])
    rig.client.read_byte(ALL)
    rig.time += 3 * ms - 1
    assert rig.read(4) == (440, 504)
    rig.time += 1
    assert rig.read(4) == (300, 504)


def test_a_conversion_is_of_the_instant_at_which_it_starts_and_of_all_cells(rig: Rig) -> None:
    rig.convert()
    assert set(rig.skin.asked) == {(0, 1000), (3, 1000)}
    assert [rig.read(2 << 3 | cell)[0] for cell in range(6)] == [400, 410, 420, 430, 440, 450]


def test_two_connected_cells_answer_together_as_the_logical_and(rig: Rig) -> None:
    rig.skin.pressure[0][:2] = 372, 223
    rig.convert()
    rig.client.write_quick(0)
    rig.client.write_quick(1)
    b = rig.client.read_i2c_block_data(CELL, 0, 4)
    assert (b[0] << 8 | b[1]) >> 6 == 84


def test_a_combined_transfer_reads_a_cell(rig: Rig) -> None:
    rig.convert()
    rig.client.write_quick(1)
    data: Any = i2c_msg.read(CELL, 4)
    rig.client.i2c_rdwr(i2c_msg.write(CELL, b"\0"), data)
    assert bytes(data) == bytes([410 >> 2, 410 << 6 & 0xFF, 501 >> 2, 501 << 6 & 0xFF])


def test_words_are_little_endian(rig: Rig) -> None:
    rig.client.write_quick(0)
    assert rig.client.read_word_data(CELL, 0x04) == 0xCE3E
    rig.client.write_byte(CELL, 0x04)
    assert [rig.client.read_byte(CELL) for _ in range(3)] == [0x3E, 0xCE, 0xB3]


def test_a_raspberry_pi_refuses_chained_reads_and_empty_messages_before_the_last(rig: Rig) -> None:
    select, register = i2c_msg.write(1, b""), i2c_msg.write(CELL, b"\0")
    data, deselect = i2c_msg.read(CELL, 4), i2c_msg.read(1, 1)
    refused(95, rig.client.i2c_rdwr, select, register, data, deselect)
    refused(5, rig.client.i2c_rdwr, select, register, data)


@pytest.mark.parametrize("rig", [Adapter()], indirect=True)
def test_a_perfect_adapter_selects_reads_and_deselects_in_one_transfer(rig: Rig) -> None:
    rig.convert()
    data: Any = i2c_msg.read(CELL, 4)
    rig.client.i2c_rdwr(i2c_msg.write(1, b""), i2c_msg.write(CELL, b"\0"), data, i2c_msg.read(1, 1))
    assert bytes(data)[0] == 410 >> 2
    refused(121, rig.client.read_byte, CELL)


@pytest.mark.parametrize("rig", [DESIGNWARE], indirect=True)
def test_an_adapter_without_quick_says_so_and_refuses_it(rig: Rig) -> None:
    assert not rig.client.funcs & I2cFunc.SMBUS_QUICK
    refused(95, rig.client.write_quick, ALL)
    refused(121, rig.client.write_byte, ALL, 0)
    rig.client.read_byte(CELL)


def test_a_scan_costs_what_it_costs_on_the_wire(rig: Rig) -> None:
    rig.convert()
    for cell in range(6):
        rig.read(cell)
    assert (rig.bus.octets, rig.bus.transfers) == (66, 21)
    for cell in range(6):
        rig.read(2 << 3 | cell)
    assert (rig.bus.octets, rig.bus.transfers) == (126, 39)


def test_defective_cells_are_dead_stuck_or_zero(rig: Rig) -> None:
    rig.convert()
    cells = rig.bus.tip(0).barometers
    cells[0].defect, cells[1].defect, cells[2].defect = Defect.DEAD, Defect.STUCK, Defect.ZERO
    rig.skin.pressure[0] = [222] * 6
    rig.convert()
    rig.client.write_quick(0)
    refused(121, rig.client.read_i2c_block_data, CELL, 0, 4)
    rig.client.read_byte(0)
    assert [rig.read(cell) for cell in (1, 2, 3)] == [(410, 501), (0, 0), (222, 503)]


def test_an_overloaded_cell_wraps(rig: Rig) -> None:
    rig.bus.cell(0, 0).overload = 410
    rig.convert()
    assert rig.read(0)[0] == 1014


@pytest.mark.parametrize("number", [121, 110, 5])
def test_a_fault_hits_the_next_messages_to_its_address_and_has_no_effect(rig: Rig, number: int) -> None:
    rig.bus.fail(number, address=1, times=2)
    rig.client.write_quick(0)
    refused(number, rig.client.write_quick, 1)
    refused(number, rig.client.write_quick, 1)
    assert len(rig.bus.fingertips[0].connected) == 1
    rig.client.write_quick(1)
    rig.bus.fail(number)
    refused(number, rig.client.read_byte, CELL)


def test_an_address_that_a_kernel_driver_owns_is_busy(rig: Rig) -> None:
    rig.bus.busy.add(CELL)
    rig.client.write_quick(0)
    refused(16, rig.client.read_byte, CELL)
    rig.client.read_byte(CELL, force=True)


def test_a_fingertip_that_is_plugged_in_again_has_powered_up(rig: Rig) -> None:
    rig.convert()
    rig.client.write_quick(0)
    rig.bus.unplug()
    refused(121, rig.client.write_quick, ALL)
    refused(121, rig.client.read_byte, CELL)
    rig.bus.plug()
    refused(121, rig.client.read_byte, CELL)
    assert rig.read(0) == (0, 0)


@pytest.mark.parametrize("number", [6, 19])
def test_what_was_open_when_the_adapter_went_away_is_dead_for_good(rig: Rig, number: int) -> None:
    rig.bus.remove(number)
    refused(number, rig.client.write_quick, ALL)
    with pytest.raises(FileNotFoundError, match=PATH):
        SMBus(PATH)
    rig.bus.restore()
    refused(number, rig.client.write_quick, ALL)
    with SMBus(PATH) as client:
        client.write_quick(ALL)


def test_a_wedged_bus_blocks_until_it_is_released(rig: Rig) -> None:
    rig.bus.wedge()
    caught = list[int | None]()

    def use() -> None:
        try:
            rig.client.write_quick(ALL)
        except OSError as error:
            caught.append(error.errno)

    thread = Thread(target=use)
    thread.start()
    assert thread.is_alive()
    rig.bus.release()
    thread.join(10.0)
    assert caught == [110]
    rig.client.write_quick(ALL)


def test_two_buses_are_served_at_once_and_files_stay_files(rig: Rig) -> None:
    other = FaultyI2cBus(Skin(), {1: 0})
    with served(other, "/dev/i2c-8"), SMBus("/dev/i2c-8") as client:
        client.write_quick(1 << 3)
        refused(121, client.write_quick, 0)
        rig.client.write_quick(0)
        refused(errno.ENOTTY, SMBus, os.devnull)
    with pytest.raises(FileNotFoundError):
        SMBus("/dev/i2c-8")


def test_a_descriptor_can_be_locked_against_others_who_open_the_same_bus(rig: Rig) -> None:
    with SMBus(PATH) as other:
        assert rig.client.fd is not None
        assert other.fd is not None
        fcntl.flock(rig.client.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        with pytest.raises(BlockingIOError):
            fcntl.flock(other.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_smbus2_is_as_it_was_when_the_block_ends() -> None:
    with served(FaultyI2cBus(Skin()), PATH):
        assert smbus2.smbus2.__dict__["os"] is not os
    assert smbus2.smbus2.__dict__["os"] is os
    assert smbus2.smbus2.__dict__["ioctl"] is fcntl.ioctl


def test_what_no_adapter_does_is_refused(rig: Rig) -> None:
    refused(95, rig.client.read_block_data, CELL, 0)
    refused(errno.EINVAL, rig.client.i2c_rdwr)
    refused(errno.EINVAL, rig.client.write_quick, 0x80)


def test_there_are_rows_0_to_7() -> None:
    with pytest.raises(ParameterError, match="rows"):
        FaultyI2cBus(Skin(), {8: 0})
