"""The command that serves the virtual lab."""

import asyncio
import logging
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.terminal import note

if TYPE_CHECKING:
    from connectors.emulators.ur_controller import Ports
    from connectors.sim.scene import Curvature

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

PORTS = 65535  # the highest
GRIPPER = 5020  # port; that of real ones, 502, is for root only


def rig(
    *,
    listen: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Where the servers listen: whoever gets there may move it.")
    ] = "127.0.0.1",
    rtde: Annotated[
        int, typer.Option(min=0, max=PORTS, help="Port of RTDE; ur-rtde knows 30004 only.")
    ] = 30004,
    script: Annotated[
        int, typer.Option(min=0, max=PORTS, help="Port of scripts; ur-rtde knows 30003 only.")
    ] = 30003,
    dashboard: Annotated[int, typer.Option(min=0, max=PORTS, help="Port; ur-rtde knows 29999 only.")] = 29999,
    gripper: Annotated[
        int,
        typer.Option(min=-1, max=PORTS, help="Port of Modbus TCP (real grippers have 502); -1: no gripper."),
    ] = GRIPPER,
    surface: Annotated[
        str, typer.Option(metavar="NAME", help="plane, sphere, cylinder_x or cylinder_y.")
    ] = "plane",
    seed: Annotated[int, typer.Option(help="Of all noise.")] = 0,
    duration: Annotated[
        str | None,
        typer.Option("--for", metavar="TIME", help="Stop after this time: 30s, 5min; else at Ctrl-C."),
    ] = None,
) -> None:
    """Serve the virtual lab: a simulated UR arm and gripper.

    One simulated scene stands behind both, which speak their own protocols. Its TakkTile bus can be had in
    the same process only, since no kernel serves it: `slipflow collect --virtual` has the whole lab inside.

    Examples:
      slipflow rig
      slipflow rig --surface sphere --gripper -1 --for 5min
    """
    from connectors.emulators.ur_controller import Ports
    from flows.graph.quantity import time
    from flows.lab.collection.plan_syntax import curvature

    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr)
    seconds = None if duration is None else time("rig", "--for", duration) / 1e9
    ports, port = Ports(rtde, script, dashboard), None if gripper < 0 else gripper
    asyncio.run(
        _serve(listen, ports, gripper=port, surface=curvature(surface, "rig"), seed=seed, seconds=seconds)
    )


async def _serve(
    listen: str,
    ports: "Ports",
    *,
    gripper: int | None,
    surface: "Curvature",
    seed: int,
    seconds: float | None,
) -> None:
    from connectors.emulators.virtual_lab import virtual_lab
    from connectors.sim.scene import commanded_scene

    note("starting; the first time, the simulated physics is compiled for some seconds")
    serving = virtual_lab(commanded_scene(surface), seed, host=listen, ports=ports, gripper=gripper)
    async with serving as lab:
        for device, address in lab.addresses.items():
            typer.echo(f"{device:10} {address}")
        sys.stdout.flush()
        try:
            async with asyncio.timeout(seconds):
                await asyncio.Event().wait()
        except TimeoutError:
            note("done")
