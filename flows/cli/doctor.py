"""The command `slipflow doctor`."""

import asyncio
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.options import Settings, load_flow

if TYPE_CHECKING:
    from flows.run.diagnosis import Findings
    from operators.ports import Endpoint

HOST = "machine"


def doctor(
    target: Annotated[
        str | None, typer.Argument(metavar="FILE[:FLOW]", help="Flow whose sources and sinks are checked.")
    ] = None,
    *,
    settings: Settings = None,
) -> None:
    """Check this machine, and the devices that a flow uses.

    Checks Python, packages, clock, disk and I2C buses, and with a flow its devices, servers and folders. Each
    line is good, a note, or bad and says how to fix it. Nothing moves; doctor scans the bus, sends one
    message to the broker (topic doctor of the rig), and writes a temporary file to each disk. First end runs
    that use the same devices. Exits 1 if anything is bad.

    Examples:
      slipflow doctor
      slipflow doctor mine.py --set robot=10.0.0.2
    """
    found = asyncio.run(_diagnose(_declared(target, settings)))
    bad = sum(finding.state == "bad" for findings in found.values() for finding in findings)
    typer.echo(_as_text(found, bad))
    if bad:
        raise typer.Exit(1)


def _declared(target: str | None, settings: list[str] | None) -> "dict[str, Endpoint]":
    """Return the sources and sinks of a flow by name."""
    if target is None:
        if settings:
            raise typer.BadParameter("--set requires a flow")
        return {}
    flow = load_flow(target, settings)
    return {node.name: part for node, part in {**flow.sources(), **flow.sinks()}.items()}


async def _diagnose(parts: "dict[str, Endpoint]") -> "Findings":
    """Check the machine, with the disk of this folder unless a part records, and `parts`."""
    from flows.run.clocks import LoopClock
    from flows.run.diagnosis import diagnose, host_findings
    from storage import Dataset

    recorded = any(isinstance(part, Dataset) for part in parts.values())
    disk: dict[str, Endpoint] = {} if recorded else {HOST: Dataset("recordings")}
    found = await diagnose({**disk, **parts}, LoopClock())
    return {HOST: [*host_findings(), *found.pop(HOST, [])], **found}


def _as_text(found: "Findings", bad: int) -> str:
    lines = list[str]()
    for part, findings in found.items():
        lines.append(part)
        lines += [f"  {each.state:4} {each.subject}: {each.text}" for each in findings]
    total = sum(map(len, found.values()))
    verdict = f"{bad} of {total} checks failed" if bad else f"{total} checks: nothing is bad"
    return "\n".join([*lines, verdict])
