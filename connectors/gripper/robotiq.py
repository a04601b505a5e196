"""Requests and status of a Robotiq 3-finger gripper in simplified control mode. No I/O.

A request is written to registers 0 to 2 (Modbus function 16), the status is read from registers 0 to 7
(function 4); a register holds two bytes.

Source: Robotiq, "3-Finger Adaptive Robot Gripper Instruction Manual", 4.3 to 4.8. The names in brackets
below are the manual's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

PORT: Final = 502
UNIT: Final = 2  # unit in the manual's examples
STATUS: Final = 8  # registers
FULL: Final = 255  # maximum position, speed and force
WEAKEST: Final = 15.0  # N, minimum grip force
STRONGEST: Final = 60.0  # N, maximum grip force
PACE: Final = 0.005  # s between requests: the gripper reads its registers at 200 Hz
SETTLE: Final = 0.010  # s until the status shows a request

FAULTS: Final = {
    0x05: "cannot act before its activation is complete",
    0x06: "cannot act before its change of mode is complete",
    0x07: "cannot act before it is activated",
    0x09: "is not ready to communicate: it may be booting",
    0x0A: "is changing its mode, and the scissor is obstructed",
    0x0B: "is releasing automatically",
    0x0D: "could not be activated: something obstructs it",
    0x0E: "could not change its mode: the scissor is obstructed",
    0x0F: "has released automatically, and must be reset",
}
_RELEASING: Final = 0x0B  # lowest code of the faults that need a reset
_READY: Final = 3  # after activation and change of mode [gIMC]


class Request(NamedTuple):
    """Request to the gripper in its basic mode [rMOD 0]; the default resets it and its fault.

    Attributes:
        active: Activate it, or keep it active [rACT].
        force: Close at full speed with this force, 0 weakest to 255 strongest; None: stay [rGTO, rPRA, rFRA].

    >>> [hex(each) for each in Request(active=True, force=255).encode()]
    ['0x900', '0xff', '0xffff']
    """

    active: bool = False
    force: int | None = None

    def encode(self) -> list[int]:
        """Return its registers."""
        if self.force is None:
            return [self.active << 8, 0, 0]
        return [(self.active | 1 << 3) << 8, FULL, FULL << 8 | self.force]


@dataclass(frozen=True, slots=True)
class Status:
    """Status of the gripper.

    Attributes:
        active: Activated, or being activated [gACT].
        ready: Activated, has changed to its mode, and can move.
        fault: 0, or one of `FAULTS` [gFLT].
    """

    active: bool = False
    ready: bool = False
    fault: int = 0

    @classmethod
    def decode(cls, registers: Sequence[int]) -> Self:
        """Return the status in the 8 registers from 0 on.

        Raises:
            ValueError: if there are not 8.
        """
        if len(registers) != STATUS:
            raise ValueError(f"a status of {len(registers)} registers")
        data = b"".join(value.to_bytes(2, "big") for value in registers)
        active = bool(data[0] & 1)
        ready = active and data[0] >> 4 & 3 == _READY
        return cls(active, ready, fault=data[2] & 0xF)

    @property
    def needs_reset(self) -> bool:
        """True if the fault lasts until a reset."""
        return self.fault >= _RELEASING

    @property
    def reason(self) -> str:
        """Description of the fault; empty if there is none.

        >>> Status(fault=0x0F).reason
        'has released automatically, and must be reset'
        """
        return FAULTS.get(self.fault, f"reports the unknown fault {self.fault:#04x}") if self.fault else ""


def force_register(force: float) -> int:
    """Return the greatest register value whose force is at most `force` (N), or 0.

    Robotiq's manual states the ends, `WEAKEST` and `STRONGEST`, and a relation of about 0.175 N per count,
    which is not quite linear.

    >>> [force_register(force) for force in (15.0, 37.5, 60.0)]
    [0, 127, 255]
    """
    share = (force - WEAKEST) / (STRONGEST - WEAKEST)
    return int(min(max(share, 0.0), 1.0) * FULL + 1e-6)  # 1e-6: the force of a register gives it back
