import asyncio
import ctypes
from collections.abc import AsyncGenerator, Callable
from types import SimpleNamespace

import pytest

from flows.run.clocks import LoopClock
from flows.run.diagnosis import clock_finding, diagnose, host_findings
from operators import Clock, Finding, InputError
from operators.extras import install_command
from operators.ports import Endpoint


class Device(Endpoint):
    """Endpoint that finds what it is given; an error is raised, None waits for ever."""

    def __init__(self, *found: Finding | Exception | None) -> None:
        self._found = found

    async def diagnose(self, clock: Clock) -> AsyncGenerator[Finding]:
        for found in self._found:
            if isinstance(found, Exception):
                raise found
            if found is None:
                await asyncio.Event().wait()
            else:
                yield found


async def test_findings_before_an_error_or_a_timeout_are_kept() -> None:
    opened = Finding("bus", "opens")
    found = await diagnose(
        {
            "silent": Device(opened, None),
            "wrong": Device(opened, InputError("a.toml", "is empty")),
            "lost": Device(ConnectionResetError(104, "Connection reset by peer")),
            "late": Device(TimeoutError(110, "Connection timed out")),
            "broken": Device(ValueError("no value")),
            "plain": Device(),
        },
        LoopClock(),
        limit=0.1,
    )
    assert found == {
        "silent": [opened, Finding("silent", "no result within 0.1 s: check that it responds", "bad")],
        "wrong": [opened, Finding("a.toml", "is empty", "bad")],
        "lost": [Finding("lost", "Connection reset by peer", "bad")],
        "late": [Finding("late", "Connection timed out", "bad")],
        "broken": [Finding("broken", "ValueError: no value", "bad")],
        "plain": [Finding("plain", "Device: nothing to check")],
    }


async def test_a_missing_extra_is_the_only_finding(hide_packages: Callable[..., None]) -> None:
    device = Device(Finding("bus", "opens"))
    device.extra = "gripper"
    hide_packages("pymodbus")
    found = (await diagnose({"device": device}, LoopClock()))["device"]
    assert found == [Finding("device", f"needs pymodbus: {install_command('gripper')}", "bad")]


def test_missing_packages_are_noted_with_their_remedy(hide_packages: Callable[..., None]) -> None:
    hide_packages("torch")
    found = {each.subject: each for each in host_findings()}
    assert (found["slipflow"].state, found["extra train"].state) == ("good", "note")
    assert found["extra train"].text.startswith("not installed; for training")
    assert found["extra report"].text.startswith("matplotlib ")


@pytest.mark.parametrize(("result", "state"), [(0, "good"), (5, "bad"), (-1, "note")])
def test_an_unsynchronised_clock_is_bad(result: int, state: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def adjtimex(_: object) -> int:
        return result

    def library(_: object) -> SimpleNamespace:
        return SimpleNamespace(adjtimex=adjtimex)

    monkeypatch.setattr(ctypes, "CDLL", library)
    assert clock_finding().state == state
