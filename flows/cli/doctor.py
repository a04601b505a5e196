"""The command `slipflow doctor`."""

import asyncio
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.options import AsJson, Rows, Settings, load_flow, parse_rows

if TYPE_CHECKING:
    from flows.run.diagnosis import Findings
    from operators.ports import Endpoint

HOST = "machine"


def doctor(
    target: Annotated[
        str | None, typer.Argument(metavar="[FILE[:FLOW]]", help="Flow whose sources and sinks are checked.")
    ] = None,
    *,
    settings: Settings = None,
    bus: Annotated[
        str | None,
        typer.Option(
            metavar="BUS", help="I2C bus of TakkTile fingertips: a number or a path (default: not checked)."
        ),
    ] = None,
    rows: Rows = "0",
    robot: Annotated[
        str | None, typer.Option(metavar="HOST", help="Address of a UR controller (default: not checked).")
    ] = None,
    gripper: Annotated[
        str | None,
        typer.Option(metavar="HOST[:PORT]", help="Address of a Robotiq gripper (default: not checked)."),
    ] = None,
    mqtt: Annotated[
        str | None, typer.Option(metavar="URL", help="MQTT broker (default: not checked).")
    ] = None,
    rig: Annotated[
        str, typer.Option(metavar="SITE/RIG", help="Rig whose rights on the broker are checked, with --mqtt.")
    ] = "lab/rig",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Dataset to record into.")] = Path("recordings"),
    as_json: AsJson = False,
) -> None:
    """Check this machine, and the devices that a flow uses.

    Checks Python, packages, clock, disk and ports, and with a flow its devices, servers and folders. Each
    line is good, a note, or bad and says how to fix it. Nothing moves; the bus is scanned, the broker
    gets one message on the topic doctor of the rig, and a temporary file is written to each disk. End runs
    that use the same devices first. Exits 1 if anything is bad.

    Examples:
      slipflow doctor
      slipflow doctor --bus 1 --rows 0,1 --robot 10.0.0.2
      slipflow doctor --mqtt mqtts://broker.example --rig lab/fingertip
      slipflow doctor mine.py --set robot=10.0.0.2
      slipflow doctor --json
    """
    from connectors import Mqtt

    parts: dict[str, Endpoint] = _declared(target, settings)
    parts |= _devices(bus, rows, robot, gripper)
    if mqtt is not None:
        site, _, name = rig.partition("/")
        parts["--mqtt"] = Mqtt(mqtt, site, name)
    found = asyncio.run(_diagnose(parts, out))
    bad = sum(finding.state == "bad" for findings in found.values() for finding in findings)
    typer.echo(_as_json(found) if as_json else _as_text(found, bad))
    if bad:
        raise typer.Exit(1)


def _declared(target: str | None, settings: list[str] | None) -> "dict[str, Endpoint]":
    """Return the sources and sinks of a flow by name."""
    from operators.ports import Sink, Source

    if target is None:
        if settings:
            raise typer.BadParameter("--set requires a flow")
        return {}
    nodes = load_flow(target, settings).nodes
    return {node.name: node.part for node in nodes if isinstance(node.part, Source | Sink)}


def _devices(bus: str | None, rows: str, robot: str | None, gripper: str | None) -> "dict[str, Endpoint]":
    """Return the sources and sinks for the options."""
    from connectors import Gripper, TakkTile, UrMotion

    found: dict[str, Endpoint] = {}
    if bus is not None:
        found["--bus"] = TakkTile(int(bus) if bus.isdigit() else bus, parse_rows(rows))
    if robot is not None:
        found["--robot"] = UrMotion(robot)
    if gripper is not None:
        host, colon, port = gripper.rpartition(":")
        if colon and not port.isdigit():
            raise typer.BadParameter(f"--gripper {gripper}: write it as HOST or HOST:PORT")
        found["--gripper"] = Gripper(host, int(port)) if colon else Gripper(gripper)
    return found


async def _diagnose(parts: "dict[str, Endpoint]", out: Path) -> "Findings":
    """Check the machine and `parts`."""
    from flows.run.clocks import LoopClock
    from flows.run.diagnosis import diagnose
    from flows.run.host_checks import host_findings
    from storage import Dataset

    clock = LoopClock()
    recorded = any(isinstance(part, Dataset) for part in parts.values())
    disk: dict[str, Endpoint] = {} if recorded else {"disk": Dataset(out)}
    machine = await diagnose(disk, clock)
    host = [*host_findings(), *(finding for name in disk for finding in machine[name])]
    return {HOST: host, **await diagnose(parts, clock)}


def _as_text(found: "Findings", bad: int) -> str:
    lines = list[str]()
    for part, findings in found.items():
        lines.append(part)
        lines += [f"  {each.state:4} {each.subject}: {each.text}" for each in findings]
    total = sum(map(len, found.values()))
    return "\n".join(
        [*lines, f"{bad} of {total} checks failed" if bad else f"{total} checks: nothing is bad"]
    )


def _as_json(found: "Findings") -> str:
    rows = [{"part": part, **asdict(each)} for part, findings in found.items() for each in findings]
    return json.dumps({"good": all(row["state"] != "bad" for row in rows), "findings": rows})
