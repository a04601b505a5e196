"""The command `slipflow collect`."""

import asyncio
import json
import os
import signal
from contextlib import AsyncExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flows.cli.event_log import begin_log
from flows.cli.options import AsJson, Recordings, Rows, Seed, parse_rows
from flows.cli.terminal import note

if TYPE_CHECKING:
    from connectors.takktile.i2c_access import I2cBus
    from connectors.ur.control_process import Pose
    from flows.lab.collection.collector import Collector
    from flows.lab.collection.stroke_plan import CollectionPlan

VIRTUAL_MARGIN = 0.03  # m; a virtual arm stops late on a busy host
VIRTUAL_TIMEOUT = 2.0  # s
VIRTUAL_WATCHDOG = 0.1  # Hz; on a busy host the time of a virtual lab is slow
DOWN = (0.0, 0.0, 0.0, 3.141592653589793, 0.0, 0.0)  # pose at which a fingertip touches a virtual surface


def collect(
    plan: Annotated[
        str, typer.Argument(metavar="PLAN", help="tiny, paper, wide, or a plan file such as mine.toml.")
    ],
    *,
    robot: Annotated[
        str | None,
        typer.Option(metavar="HOST", help="Address of the UR controller (default 127.0.0.1 with --virtual)."),
    ] = None,
    bus: Annotated[
        str, typer.Option(metavar="BUS", help="I2C bus of the fingertips: a number or a path.")
    ] = "1",
    rows: Rows = "0",
    out: Recordings = Path("recordings"),
    depth: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH", help="Press depth after first contact, at most 6mm (default: as planned)."
        ),
    ] = None,
    force: Annotated[
        str | None,
        typer.Option(
            metavar="FORCE",
            help="Press with a force, such as 2N, instead of to a depth (default: as planned). An e-Series"
            " arm measures it; a CB3 arm estimates it within about 10 N.",
        ),
    ] = None,
    seed: Seed = 0,
    virtual: Annotated[
        bool, typer.Option("--virtual", help="Run on a virtual lab instead of a robot.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the path, its duration and bounds; do not move the arm.")
    ] = False,
    show: Annotated[
        bool, typer.Option("--print", help="Print the plan file, as a template to edit; do not move the arm.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Drive an arm through a collection plan and record it.

    The result is a labelled dataset with splits. The plan file has surfaces, speeds, depth or force,
    workspace and limits. Unless it gives the pose of the surface, start with the fingertip just touching
    it. Each stroke moves down, rests, slides, rests and moves up. Ctrl-C stops the arm and then commits the
    recording; SIGUSR1 pauses and resumes. The collection ends, with the arm stopped, if the controller
    stops, a limit of the plan is exceeded, or a fingertip gives no samples or measures no contact. Needs the
    ur extra, except with --dry-run.

    Examples:
      slipflow collect tiny --dry-run --robot 10.0.0.2
      slipflow collect tiny --virtual --out lab
      slipflow collect paper --robot 10.0.0.2 --force 2N
      slipflow collect paper --print > mine.toml
      slipflow collect mine.toml --robot 10.0.0.2 --out lab
    """
    from flows.graph.quantity import parse_quantity
    from flows.lab.collection.plan_file import load_plan, plan_text

    if show:
        typer.echo(plan_text(plan)[1], nl=False)
        return
    if depth is not None and force is not None:
        raise typer.BadParameter("give --depth or --force, not both")
    if robot is None and not virtual and not dry_run:
        raise typer.BadParameter("give --robot HOST, or --virtual for a virtual lab, or --dry-run")
    chosen = load_plan(plan)
    press = chosen.press
    if depth is not None:
        press = replace(press, depth=parse_quantity("collect", "--depth", depth, "m"), force=None)
    if force is not None:
        press = replace(press, force=parse_quantity("collect", "--force", force, "N"))
    chosen = replace(chosen, press=press)
    if virtual:
        chosen = _on_virtual_lab(chosen)
    with suppress(ValueError):  # not in the main thread
        signal.signal(signal.SIGUSR1, signal.SIG_IGN)  # else it ends the process before and after the strokes
    begin_log()
    if dry_run:
        _print_path(chosen, robot, seed, virtual=virtual, as_json=as_json)
    else:
        from connectors.emulators.lab_loop import run_lab
        from connectors.ur.control_process import check_ur_rtde

        check_ur_rtde()
        execute = run_lab if virtual else asyncio.run
        work = _collect(
            chosen, robot or "127.0.0.1", bus, parse_rows(rows), out=out, seed=seed, virtual=virtual
        )
        _report(execute(work), as_json=as_json)


def _on_virtual_lab(plan: "CollectionPlan") -> "CollectionPlan":
    """Return the plan for the surface of a virtual lab, with limits for a busy host."""
    if len(plan.surfaces) > 1:
        raise typer.BadParameter("--virtual: a virtual lab has one surface, the plan has several")
    limits = replace(
        plan.limits,
        margin=max(plan.limits.margin, VIRTUAL_MARGIN),
        sensor_timeout=max(plan.limits.sensor_timeout, VIRTUAL_TIMEOUT),
        watchdog=min(plan.limits.watchdog, VIRTUAL_WATCHDOG),
    )
    surfaces = tuple(replace(each, pose=each.pose or DOWN) for each in plan.surfaces)
    return replace(plan, limits=limits, surfaces=surfaces)


def _print_path(
    plan: "CollectionPlan", robot: str | None, seed: int, *, virtual: bool, as_json: bool
) -> None:
    """Print the path from the arm's pose, if known."""
    from connectors.emulators.virtual_lab import HEIGHT
    from flows.lab.collection.collection_report import describe_plan, plan_table
    from flows.lab.collection.collector import read_pose, workspace
    from flows.run.clocks import LoopClock

    async def ask(robot: str) -> "Pose":
        return await read_pose(robot, LoopClock())

    surface, here = DOWN, None
    if virtual:
        here = (*DOWN[:2], HEIGHT, *DOWN[3:])
    elif robot is not None:
        surface = here = asyncio.run(ask(robot))
    else:
        note("without --robot or --virtual the arm's pose is unknown: the path starts above the surface")
        if any(each.pose is None for each in plan.surfaces):
            note("and the surface is placed at the origin of the base frame")
    series = plan.series(surface, seed)
    found = describe_plan(series, *workspace(series, here, plan.limits), here)
    typer.echo(json.dumps(found) if as_json else plan_table(found))


async def _collect(
    plan: "CollectionPlan",
    robot: str,
    bus: str,
    rows: tuple[int, ...],
    *,
    out: Path,
    seed: int,
    virtual: bool,
) -> "Collector":
    from connectors.emulators.virtual_lab import virtual_lab
    from connectors.sim.scene import commanded_scene
    from flows.lab.collection.collector import collect
    from flows.run.clocks import LoopClock

    async with AsyncExitStack() as running:
        devices: int | str | I2cBus = int(bus) if bus.isdigit() else bus
        clock = None
        if virtual:
            note("starting the virtual lab; the first start compiles its physics, which takes some seconds")
            scene = commanded_scene(plan.surfaces[0].shape, plan.surfaces[0].radius)
            serving = virtual_lab(scene, seed, fingers=rows, host=robot)
            lab = await running.enter_async_context(serving)
            lab.wait_for_commands()
            devices, clock = lab.bus, LoopClock(lab.scene.now())
        note(f"to pause and to resume: kill -USR1 {os.getpid()}")
        return await collect(plan, robot, out, bus=devices, rows=rows, seed=seed, log=note, clock=clock)


def _report(result: "Collector", *, as_json: bool) -> None:
    """Print the result, and set the exit code."""
    from flows.lab.collection.collection_report import describe_result, result_text

    found: dict[str, Any] = describe_result(result)
    typer.echo(json.dumps(found) if as_json else result_text(found))
    if result.interrupted:
        typer.echo("interrupted; the arm has stopped where it is", err=True)
        raise typer.Exit(130)
    if result.error:
        typer.echo(f"error: {result.error}; the arm has stopped where it is", err=True)
        raise typer.Exit(2)
    if any(each["dropped"] or each["gaps"] for each in found["sessions"]):
        raise typer.Exit(1)
