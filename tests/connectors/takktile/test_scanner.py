"""The scanner on an emulated bus, through an unmodified smbus2."""

import errno
import os
from collections.abc import Iterator
from contextlib import closing
from time import time_ns

import numpy as np
import pytest
from smbus2 import SMBus

from connectors.takktile.scanner import Scan, Scanner, i2c_reason
from connectors.takktile.takktile_protocol import Coefficients
from operators.batch import Counts, us
from tests.connectors.takktile.takktile_rig import PATH, Bus
from tests.emulators.i2c_bus import Cell, Defect, Fingertip, served

CELL, ALL = 0x60, 0x06


class Rig:
    """Bus with the fingertips 4 and 5 at rows 0 and 3."""

    rows = (0, 3)
    fingers = (4, 5)

    def __init__(self) -> None:
        self.bus = Bus(dict(zip(self.rows, self.fingers, strict=True)))
        self.skin = self.bus.skin
        self.coefficients: list[list[Coefficients | None]] = [[None] * 6, [None] * 6]

    def open(self) -> Scanner:
        return Scanner(PATH, dict(zip(self.rows, self.coefficients, strict=True)), time_ns)

    def right(self, scan: Scan) -> None:
        """Check that valid cells have the counts of the last conversion."""
        for fingertip, finger in enumerate(self.fingers):
            valid = scan.valid[fingertip]
            np.testing.assert_array_equal(scan.counts[fingertip][valid], self.pressure(finger)[valid])
            np.testing.assert_array_equal(
                scan.temperature[fingertip][valid], self.skin.temperature(finger)[valid]
            )

    def pressure(self, finger: int) -> Counts:
        return self.skin.pressure(finger, self.skin.conversions)

    def sound(self, scan: Scan) -> None:
        """Check that all cells are valid and right."""
        assert scan.error is None
        assert scan.valid.all()
        self.right(scan)


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    monkeypatch.setattr("connectors.takktile.scanner.CONVERSION", 100 * us)
    rig = Rig()
    with served(rig.bus, PATH):
        yield rig


def invalid(scan: Scan) -> list[tuple[int, int]]:
    return [(int(fingertip), int(cell)) for fingertip, cell in np.argwhere(~scan.valid)]


@pytest.mark.parametrize("number", [121, 6, 110, 5, 19])
@pytest.mark.parametrize("times", [1, 3])
def test_after_any_failed_message_valid_cells_are_right_and_the_next_scan_is_complete(
    rig: Rig, number: int, times: int
) -> None:
    with closing(rig.open()) as scanner:
        spoilt = 0
        for message in range(52):  # of a scan
            rig.bus.fail(number, after=message, times=times)
            scan = scanner.scan()
            rig.bus.heal()
            spoilt += scan.error is not None or bool(invalid(scan))
            rig.right(scan)
            rig.sound(scanner.scan())
        assert spoilt >= 51  # one message is to be refused: it asks whether all cells are silent


def test_a_blocked_bus_costs_a_scan_at_most_two_timeouts(rig: Rig) -> None:
    with closing(rig.open()) as scanner:
        for message in range(52):
            rig.bus.fail(110, after=message, times=1000)
            scanner.scan()
            assert rig.bus.heal() <= 2


def test_a_bus_error_invalidates_the_scan_and_a_silent_cell_only_itself(rig: Rig) -> None:
    with closing(rig.open()) as scanner:
        rig.bus.fail(110, address=3 << 3 | 1)
        scan = scanner.scan()
        assert scan.error is not None
        assert scan.error.errno == errno.ETIMEDOUT
        assert not scan.valid.any()
        assert not scan.counts.any()
        rig.bus.fail(121, address=3 << 3 | 1)
        scan = scanner.scan()
        assert invalid(scan) == [(1, 1)]
        assert scan.counts.shape == (2, 6)
        rig.right(scan)


def test_an_overloaded_cell_is_invalid_while_its_count_is_wrapped(rig: Rig) -> None:
    with closing(rig.open()) as scanner:
        cell = rig.bus.fingertips[0].cells[3]
        seen = list[bool]()
        for overload in (0, 200, 380, 480, 600, 470, 200, 0):
            cell.overload = overload
            scan = scanner.scan()
            seen.append(bool(scan.valid[0, 3]))
            assert scan.counts[0, 3] == (rig.pressure(4)[3] - overload) % 1024
            assert scan.valid.sum() == 11 + seen[-1]
        assert seen == [True, True, True, False, False, False, True, True]


def test_connected_cells_are_disconnected_at_the_start(rig: Rig) -> None:
    with SMBus(PATH) as other:
        other.write_quick(ALL)
    with closing(rig.open()) as scanner:
        rig.sound(scanner.scan())


def test_a_cell_that_stays_connected_spoils_every_scan(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def connected(fingertip: Fingertip) -> list[Cell]:
        return fingertip.cells[:1]

    with closing(rig.open()) as scanner:
        monkeypatch.setattr(Fingertip, "connected", property(connected))
        scan = scanner.scan()
        assert not scan.valid.any()
        assert scan.error is not None
        assert "though all barometers are disconnected" in i2c_reason(scan.error)
    with pytest.raises(OSError, match="though all barometers are disconnected"):
        rig.open()


@pytest.mark.parametrize("claims", ["nothing", "quick"])
@pytest.mark.parametrize("refused", [errno.EREMOTEIO, errno.ENXIO])
def test_an_adapter_without_quick_gets_a_byte(
    rig: Rig, claims: str, refused: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.emulators.i2c_bus.NOT_ACKNOWLEDGED", refused)
    if claims == "quick":
        monkeypatch.setattr("tests.emulators.i2c_bus._EMULATED_QUICK", 0)
    rig.bus.quick = False
    with closing(rig.open()) as scanner:
        for _ in range(2):
            rig.sound(scanner.scan())
        rig.bus.fail(121, address=CELL, after=7)
        rig.right(scanner.scan())
        rig.sound(scanner.scan())
        rig.bus.fail(5, address=ALL)
        assert not scanner.scan().valid.any()
        rig.sound(scanner.scan())


def test_coefficients_are_read_once(rig: Rig) -> None:
    with closing(rig.open()) as scanner:
        assert rig.coefficients[1][0] == Coefficients.decode(bytes.fromhex("3ECE B3F9 C517 33C8"))
        known = [cell.a0 for cell in rig.coefficients[0] if cell]
        assert known == pytest.approx([2009.75 + cell for cell in range(6)])
        transfers = rig.bus.transfers
        scanner.scan()
        assert rig.bus.transfers - transfers == 40  # those of a scan: none is read again


def test_one_wrong_bit_in_coefficients_is_noticed_and_they_are_read_again(rig: Rig) -> None:
    cell, flips = rig.bus.fingertips[3].cells[2], [1 << 40, 1 << 24]
    right, read = bytes(cell.registers[4:12]), Cell.read

    def wrong(self: Cell, length: int, now: int) -> bytes:
        data = read(self, length, now)
        flip = flips.pop() if self is cell and length == 8 and flips else 0
        return (int.from_bytes(data, "big") ^ flip).to_bytes(length, "big")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Cell, "read", wrong)
        rig.open().close()
    assert rig.coefficients[1][2] == Coefficients.decode(right)
    rig.bus.fail(121, address=3 << 3 | 5)
    rig.bus.fingertips[3].cells[4].defect = Defect.DEAD
    rig.open().close()
    assert [cell for cell, known in enumerate(rig.coefficients[1]) if known is None] == [4]


def test_an_error_names_its_remedy() -> None:
    with pytest.raises(OSError, match="ioctl") as no_bus:
        Scanner("/dev/null", {}, time_ns)
    assert i2c_reason(no_bus.value).startswith("is no I2C bus: ")
    failed = OSError(errno.EIO, os.strerror(errno.EIO))
    assert i2c_reason(failed) == "Input/output error; check the cable and the power (errno 5)"


def test_a_bus_is_locked(rig: Rig) -> None:
    with closing(rig.open()):
        with pytest.raises(BlockingIOError) as raised:
            rig.open()
        assert i2c_reason(raised.value).startswith("is in use: end the other program or source, ")
    rig.open().close()


@pytest.mark.parametrize("number", [110, 121, 5])
def test_a_bus_that_cannot_be_used_is_closed_again(rig: Rig, number: int) -> None:
    before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208 - counted, not used
    for after in range(3):
        rig.bus.fail(number, address=ALL, after=0)
        rig.bus.fail(number, address=CELL, after=after, times=2)
        with pytest.raises(OSError, match=os.strerror(number)):
            rig.open()
    assert len(os.listdir("/proc/self/fd")) == before  # noqa: PTH208 - the same
