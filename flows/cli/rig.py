"""The command `slipflow rig`."""

import asyncio
import sys
from typing import TYPE_CHECKING, Annotated, cast

import typer

from flows.cli.event_log import begin_log
from flows.cli.options import Duration, Seed
from flows.cli.terminal import note

if TYPE_CHECKING:
    from connectors.sim.scene import Curvature

MAX_PORT = 65535
GRIPPER = 5020  # port 502 of real grippers needs root


def rig(
    *,
    listen: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="Address on which the servers listen; every client can move the arm.",
        ),
    ] = "127.0.0.1",
    gripper: Annotated[
        int,
        typer.Option(min=-1, max=MAX_PORT, help="Modbus port of the gripper; -1: no gripper."),
    ] = GRIPPER,
    surface: Annotated[
        str,
        typer.Option(metavar="NAME", help="Surface: plane, sphere, cylinder_x or cylinder_y."),
    ] = "plane",
    seed: Seed = 0,
    duration: Duration = None,
) -> None:
    """Serve the virtual lab: a simulated UR arm and gripper.

    Its TakkTile bus exists in this process only; `slipflow collect --virtual` runs the whole lab in one
    process. The gripper needs the gripper extra.

    Examples:
      slipflow rig
      slipflow rig --surface sphere --gripper -1 --for 5min
    """
    from typing import get_args

    from connectors.emulators.lab_loop import run_lab
    from connectors.sim.scene import Curvature
    from flows.graph.quantity import parse_time
    from operators.checks import check_choice
    from operators.extras import require_extra

    begin_log()
    if gripper >= 0:
        require_extra("gripper", "rig, unless --gripper is -1,")
    check_choice("rig", "--surface", surface, get_args(Curvature))
    seconds = None if duration is None else parse_time("rig", "--for", duration) / 1e9
    port, shape = None if gripper < 0 else gripper, cast("Curvature", surface)
    run_lab(_serve(listen, gripper=port, surface=shape, seed=seed, seconds=seconds))


async def _serve(
    listen: str,
    *,
    gripper: int | None,
    surface: "Curvature",
    seed: int,
    seconds: float | None,
) -> None:
    from connectors.emulators.virtual_lab import virtual_lab
    from connectors.sim.scene import commanded_scene

    serving = virtual_lab(commanded_scene(surface), seed, host=listen, gripper=gripper)
    async with serving as lab:
        for device, address in lab.addresses.items():
            typer.echo(f"{device:10} {address}")
        sys.stdout.flush()
        try:
            async with asyncio.timeout(seconds):
                await asyncio.Event().wait()
        except TimeoutError:
            note("done")
