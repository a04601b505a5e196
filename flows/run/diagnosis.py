"""Checks before a run: sources and sinks, each with a timeout and all at the same time."""

import asyncio
from collections.abc import Mapping
from contextlib import aclosing
from typing import Final, TypeAlias

from operators.errors import EndpointError, InputError, SlipflowError, os_error_reason
from operators.extras import require_extra
from operators.ports import Clock, Endpoint, Finding

LIMIT: Final = 20.0  # s, for a source or sink

Findings: TypeAlias = dict[str, list[Finding]]  # by part


async def diagnose(parts: Mapping[str, Endpoint], clock: Clock, limit: float = LIMIT) -> Findings:
    """Return the findings about sources and sinks, by their names, each within `limit` (s)."""
    found: Findings = {name: [] for name in parts}
    await asyncio.gather(*(_diagnose(name, part, clock, limit, found[name]) for name, part in parts.items()))
    return found


async def _diagnose(name: str, part: Endpoint, clock: Clock, limit: float, found: list[Finding]) -> None:
    try:
        if part.extra:
            require_extra(part.extra, name)
        async with asyncio.timeout(limit), aclosing(part.diagnose(clock)) as findings:
            try:
                async for finding in findings:
                    found += [finding]  # at once: an error may follow
            except TimeoutError as error:  # of the part itself, such as a connection's
                found.append(_failure(name, error))
    except TimeoutError:
        found.append(Finding(name, f"no result within {limit:g} s: check that it responds", "bad"))
    except Exception as error:  # noqa: BLE001 - the finding itself
        found.append(_failure(name, error))
    if not found:
        found.append(Finding(name, f"{type(part).__name__}: nothing to check"))


def _failure(name: str, error: Exception) -> Finding:
    """Return the finding that an error stands for."""
    match error:
        case EndpointError():
            return Finding(error.endpoint, error.reason, "bad")
        case InputError():
            return Finding(error.where, error.reason, "bad")
        case SlipflowError():
            return Finding(name, str(error), "bad")
        case OSError():
            return Finding(name, os_error_reason(error), "bad")
        case _:
            return Finding(name, f"{type(error).__name__}: {error}", "bad")
