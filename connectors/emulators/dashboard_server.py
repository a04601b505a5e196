"""Dashboard server of an emulated UR controller: one reply line per request line.

Source: Universal Robots, "Dashboard Server e-Series, port 29999" and "..., CB-Series".
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from connectors.emulators.ur_control_box import ControlBox, RuntimeState

GREETING: Final = "Connected: Universal Robots Dashboard Server"
FAREWELL: Final = "Disconnected"
SERIAL_NUMBER: Final = "20195501234"  # ur-rtde requires one


def answer(box: ControlBox, line: str) -> str:
    """Execute a request line on a control box and return the reply.

    Unknown requests are answered as a real server does: ``could not understand: REQUEST``.
    """
    request = line.strip()
    execute = _COMMANDS.get(request.lower())
    return execute(box) if execute else f"could not understand: {request}"


def _stop(box: ControlBox) -> str:
    if box.runtime_state == RuntimeState.STOPPED:
        return "Failed to execute: stop"
    box.stop_program()
    return "Stopped"


def _unlock(box: ControlBox) -> str:
    box.unlock()
    return "Protective stop releasing"


def _state(box: ControlBox) -> str:
    return f"{box.runtime_state.name} {box.program or '<unnamed>'}"


_COMMANDS: Final[Mapping[str, Callable[[ControlBox], str]]] = MappingProxyType(
    {
        "polyscopeversion": lambda box: f"URSoftware {box.version} (Jan 01 2022)",
        "get serial number": lambda _: SERIAL_NUMBER,
        "is in remote control": lambda _: "true",
        "running": lambda box: f"Program running: {str(box.runtime_state == RuntimeState.PLAYING).lower()}",
        "programstate": _state,
        "stop": _stop,
        "robotmode": lambda box: f"Robotmode: {box.robot_mode.name}",
        "safetystatus": lambda box: f"Safetystatus: {box.safety_mode.name}",
        "unlock protective stop": _unlock,
        "quit": lambda _: FAREWELL,
    }
)
