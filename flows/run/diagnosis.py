"""Checks before a run: the machine; sources and sinks, each with a timeout and all at the same time."""

import asyncio
import ctypes
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import aclosing
from importlib.metadata import version
from pathlib import Path
from struct import unpack_from
from typing import Final, TypeAlias

from flows.run.failures import reason_of
from operators.errors import EndpointError, InputError
from operators.extras import EXTRAS, install_command, is_installed, require_extra, software_version
from operators.ports import Clock, Endpoint, Finding

LIMIT: Final = 20.0  # s, for a source or sink
_TIMEX: Final = "@Illl"  # start of struct timex: modes, offset, frequency, largest error (us)
_TIMEX_BYTES: Final = 512  # at least
_TIME_ERROR: Final = 5  # result of adjtimex: not synchronised

Findings: TypeAlias = dict[str, list[Finding]]  # by part


async def diagnose(parts: Mapping[str, Endpoint], clock: Clock, limit: float = LIMIT) -> Findings:
    """Return the findings about sources and sinks, by their names, each within `limit` (s)."""
    found = await asyncio.gather(*(_diagnose(name, part, clock, limit) for name, part in parts.items()))
    return dict(zip(parts, found, strict=True))


async def _diagnose(name: str, part: Endpoint, clock: Clock, limit: float) -> list[Finding]:
    found, timeout = list[Finding](), asyncio.timeout(limit)
    try:
        if part.extra:
            require_extra(part.extra, name)
        async with timeout, aclosing(part.diagnose(clock)) as findings:
            async for finding in findings:
                found += [finding]  # at once: an error may follow
    except Exception as error:  # noqa: BLE001 - the finding itself
        silent = Finding(name, f"no result within {limit:g} s: check that it responds", "bad")
        found.append(silent if timeout.expired() else _failure(name, error))
    return found or [Finding(name, f"{type(part).__name__}: nothing to check")]


def _failure(name: str, error: Exception) -> Finding:
    """Return the finding that an error stands for."""
    match error:
        case EndpointError(endpoint=subject, reason=text) | InputError(where=subject, reason=text):
            return Finding(subject, text, "bad")
        case _:
            return Finding(name, reason_of(error), "bad")


def i2c_finding() -> Finding:
    """Return which I2C buses this user can access."""
    buses = sorted(Path("/dev").glob("i2c-*"))
    if not buses:
        text = "no bus; to attach fingertips here, enable I2C, for example in raspi-config"
        return Finding("I2C", text, "note")
    names = ", ".join(map(str, buses))
    if locked := [str(bus) for bus in buses if not os.access(bus, os.R_OK | os.W_OK)]:
        remedy = "add the user: sudo usermod -aG i2c $USER, then log in again"
        return Finding("I2C", f"{', '.join(locked)} may be used only by the group i2c; {remedy}", "note")
    return Finding("I2C", f"{names}; give a flow to check its fingertips")


def host_findings() -> Iterator[Finding]:
    """Yield findings about Python, slipflow and its extras, the clock, and I2C buses."""
    yield Finding("Python", sys.version.split()[0])
    yield Finding("slipflow", software_version())
    for extra, about in EXTRAS.items():
        if not is_installed(extra):
            text = f"not installed; for {about.use}: {install_command(extra)}"
            yield Finding(f"extra {extra}", text, "note")
        else:
            yield Finding(f"extra {extra}", f"{about.package} {version(about.package)}")
    yield clock_finding()
    yield i2c_finding()


def clock_finding() -> Finding:
    """Return whether the system's clock is synchronised, as the kernel reports it."""
    result = ctypes.create_string_buffer(_TIMEX_BYTES)
    state = ctypes.CDLL(None).adjtimex(result)
    if state < 0:
        return Finding("clock", "the system does not say whether it is synchronised", "note")
    if state == _TIME_ERROR:
        remedy = "run an NTP client, for example: timedatectl set-ntp true"
        return Finding("clock", f"not synchronised, so times of events are wrong elsewhere: {remedy}", "bad")
    return Finding("clock", f"synchronised within {unpack_from(_TIMEX, result)[3] / 1000:.1f} ms")
