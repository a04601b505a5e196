from collections.abc import Iterator

import numpy as np
import pytest

from connectors import TakkTile
from flows.run.clocks import LoopClock
from flows.run.diagnosis import diagnose
from operators import us
from operators.ports import Finding
from tests.emulators.i2c_bus import Defect, EmulatedI2cBus, Table, served

PATH = "/dev/i2c-1"
UNLOADED = np.full((1, 6), 400, np.int16)


@pytest.fixture
def bus() -> Iterator[EmulatedI2cBus]:
    """A bus with fingertips at the rows 0 and 5."""
    bus = EmulatedI2cBus(Table(*[UNLOADED] * 2), {0: 0, 5: 1}, conversion=200 * us)
    with served(bus, PATH):
        yield bus


async def found(*rows: int) -> list[Finding]:
    source = TakkTile(1, rows, rate=50.0)
    return (await diagnose({"touch": source}, LoopClock()))["touch"]


@pytest.mark.usefixtures("bus")
async def test_cells_and_rate_of_working_fingertips_are_good() -> None:
    opened, *rows, rate = await found(0, 5)
    assert opened == Finding(PATH, "opens")
    assert rows == [Finding(f"{PATH} row {row}", "6 cells answer") for row in (0, 5)]
    assert (rate.subject, rate.text.endswith(" rows per second of 50")) == (PATH, rate.state == "good")


@pytest.mark.usefixtures("bus")
async def test_a_wrong_row_is_bad_and_the_right_ones_are_named() -> None:
    text = "does not answer; rows 0, 5 answer: declare them, or program the fingertip"
    assert (await found(3))[1:] == [Finding(f"{PATH} row 3", text, "bad")]
    assert (await found(0, 3))[2] == Finding(f"{PATH} row 3", text, "bad")


async def test_silent_and_defective_cells_are_named(bus: EmulatedI2cBus) -> None:
    bus.fingertips[0].cells[2].defect = Defect.DEAD
    bus.fingertips[5].cells[4].defect = Defect.ZERO
    silent, defective = (await found(0, 5))[1:3]
    assert (silent.state, silent.text.startswith("cells 2 do not answer")) == ("bad", True)
    assert (defective.state, defective.text.startswith("cells 4 give implausible values")) == ("bad", True)
    for cell in bus.fingertips[5].cells:
        cell.defect = Defect.ZERO
    [failed] = await found(5)
    assert (failed.state, failed.text.startswith("no cell gives plausible values: ")) == ("bad", True)


async def test_wrong_coefficients_and_pressures_are_named(bus: EmulatedI2cBus) -> None:
    cells = bus.fingertips[0].cells
    cells[3].registers[4:12] = bytes.fromhex("BECE B3F9 C517 33C8")
    cells[5].overload = 300
    wrong, far = (await found(0, 5))[1], (await found(5))[1]
    assert wrong.text.startswith("cells 3 have coefficients that no barometer has")
    assert (wrong.state, far.state) == ("bad", "good")
    cells[3].registers[4:12] = cells[0].registers[4:12]
    far = (await found(0))[1]
    assert far.state == "bad"
    assert far.text.startswith("the pressure is outside 50 to 115 kPa: cell 5 136 kPa; unload the fingertip")


async def test_a_missing_bus_or_fingertip_is_bad_with_its_remedy(bus: EmulatedI2cBus) -> None:
    for row in bus.fingertips:
        bus.fingertips[row].plugged = False
    silent = "no fingertip answers: check the power and the rows (errno 121)"
    assert await found(0) == [Finding(PATH, silent, "bad")]
    [missing] = (await diagnose({"touch": TakkTile(99)}, LoopClock()))["touch"]
    assert missing == Finding("/dev/i2c-99", "the bus does not exist: is I2C enabled? (errno 2)", "bad")


async def test_a_slow_bus_is_bad(bus: EmulatedI2cBus) -> None:
    bus.speed = 20_000
    rate = (await found(0, 5))[-1]
    assert rate.state == "bad"
    assert "use a faster bus (400 kHz), fewer fingertips on the bus or a lower rate" in rate.text
