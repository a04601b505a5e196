"""The command `slipflow collect`."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.event_log import begin_log
from flows.cli.options import Recordings, Rows, parse_rows
from flows.cli.terminal import note

if TYPE_CHECKING:
    from connectors.ur.ur_state import Pose
    from flows.lab.collection.collector import Collector
    from flows.lab.collection.stroke_plan import CollectionPlan, PlannedPath

DOWN = (0.0, 0.0, 0.0, 3.141592653589793, 0.0, 0.0)  # pose of a surface without one, if the arm's is unknown


def collect(
    plan: Annotated[
        str, typer.Argument(metavar="PLAN", help="tiny, paper, wide, or a plan file such as mine.toml.")
    ],
    *,
    robot: Annotated[str | None, typer.Option(metavar="HOST", help="Address of the UR controller.")] = None,
    bus: Annotated[
        str, typer.Option(metavar="BUS", help="I2C bus of the fingertips: a number or a path.")
    ] = "1",
    rows: Rows = "0",
    out: Recordings = Path("recordings"),
    virtual: Annotated[
        bool, typer.Option("--virtual", help="Use the simulated arm and fingertips instead of a robot.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the path, its duration and bounds; do not move the arm.")
    ] = False,
    show: Annotated[
        bool, typer.Option("--print", help="Print the plan file, as a template to edit; do not move the arm.")
    ] = False,
) -> None:
    """Drive an arm through a collection plan and record it.

    The result is a labelled dataset with splits. The plan file has surfaces, speeds, depth, workspace, limits
    and seed. Unless it gives the pose of the surface, start with the fingertip just touching it. Each stroke
    moves down, rests, slides, rests and moves up. Ctrl-C stops the arm and then commits the recording. The
    collection ends, with the arm stopped, if the controller stops, a limit of the plan is exceeded, or a
    fingertip gives no samples or measures no contact. A robot needs the ur extra, except with --dry-run.

    Examples:
      slipflow collect tiny --virtual --out lab
      slipflow collect paper --print > mine.toml
      slipflow collect mine.toml --dry-run --robot 10.0.0.2
      slipflow collect mine.toml --robot 10.0.0.2 --out recordings
    """
    from flows.lab.collection.collection_report import path_text
    from flows.lab.collection.plan_file import load_plan, plan_text

    if show:
        typer.echo(plan_text(plan)[1], nl=False)
        return
    if robot is None and not virtual and not dry_run:
        raise typer.BadParameter("give --robot HOST, or --virtual for the simulated arm, or --dry-run")
    begin_log()
    chosen = load_plan(plan)
    if dry_run:
        typer.echo(path_text(asyncio.run(_planned(chosen, robot, virtual=virtual))))
        return
    if not virtual:
        from operators.extras import require_extra

        require_extra("ur", "commanding a UR arm")
    _report(asyncio.run(_collect(chosen, robot, bus, parse_rows(rows), out, virtual=virtual)))


async def _planned(plan: "CollectionPlan", robot: str | None, *, virtual: bool) -> "PlannedPath":
    """Return the path from the arm's pose, if known."""
    from connectors.sim.simulated_arm import start_pose
    from connectors.ur.ur_state import read_state
    from flows.lab.collection.stroke_plan import PlannedPath
    from flows.run.clocks import LoopClock

    if virtual:
        return PlannedPath.of(plan, DOWN, start_pose(plan.surfaces[0].pose or DOWN))
    if robot is not None:
        here: Pose = (await read_state(LoopClock(), robot)).pose
        return PlannedPath.of(plan, here, here)
    note("without --robot or --virtual the arm's pose is unknown: the path starts above the surface")
    if any(each.pose is None for each in plan.surfaces):
        note("and the surface is placed at the origin of the base frame")
    return PlannedPath.of(plan, DOWN)


async def _collect(
    plan: "CollectionPlan", robot: str | None, bus: str, rows: tuple[int, ...], out: Path, *, virtual: bool
) -> "Collector":
    from connectors import TakkTile, UrMotion
    from connectors.ur.ur_arm import UrArm
    from flows.lab.collection.collector import Collector, collect, virtual_arm
    from flows.run.clocks import LoopClock

    path, clock = await _planned(plan, robot, virtual=virtual), LoopClock()
    if virtual:
        note("the first start compiles the physics, which takes some seconds")
        moved = await virtual_arm(path, clock, fingers=tuple(range(len(rows))))
        collector = Collector(path, moved, moved.fingertips, moved.motion, out, clock, note)
    else:
        assert robot
        limits, touch = plan.limits, TakkTile(int(bus) if bus.isdigit() else bus, rows)
        arm = UrArm(robot, path.bounds, clock, watchdog=limits.watchdog, path_tolerance=limits.margin)
        collector = Collector(path, arm, touch, UrMotion(robot), out, clock, note)
    await collect(collector)
    return collector


def _report(result: "Collector") -> None:
    """Print the result, and set the exit code."""
    from flows.lab.collection.collection_report import result_text

    typer.echo(result_text(result))
    if result.interrupted:
        typer.echo("interrupted; the arm has stopped where it is", err=True)
        raise typer.Exit(130)
    if result.error:
        typer.echo(f"error: {result.error}; the arm has stopped where it is", err=True)
        raise typer.Exit(2)
    sinks = [sink for run in result.runs for sink in run.sinks.values() if sink.records]
    if any(sink.dropped for sink in sinks) or any(
        s.gaps for run in result.runs for s in run.sources.values()
    ):
        raise typer.Exit(1)
