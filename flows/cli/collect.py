"""The command `slipflow collect`."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.options import Recordings, Rows, parse_rows
from flows.cli.terminal import begin_log, note
from flows.report.table import counted

if TYPE_CHECKING:
    from connectors.ur.ur_state import Point
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
    and seed. Unless it states the pose of the surface, start with the fingertip just touching it. Ctrl-C
    stops the arm and then stores the recording. The collection also stops if the controller stops, a limit of
    the plan is exceeded, or a fingertip gives no samples or measures no contact. A robot needs the extra
    `ur`, except with --dry-run.

    Examples:
      slipflow collect tiny --virtual --out lab
      slipflow collect paper --print > mine.toml
      slipflow collect mine.toml --dry-run --robot 10.0.0.2
      slipflow collect mine.toml --robot 10.0.0.2 --out recordings
    """
    from flows.lab.collection.plan_file import load_plan, plan_text

    if show:
        typer.echo(plan_text(plan)[1], nl=False)
        return
    if robot is None and not virtual and not dry_run:
        raise typer.BadParameter("give --robot HOST, or --virtual for the simulated arm, or --dry-run")
    begin_log()
    chosen = load_plan(plan)
    if dry_run:
        if robot is None and not virtual:
            note("the arm's pose is unknown: the path starts above the surface (by default at the origin)")
        typer.echo(_path_text(asyncio.run(_planned(chosen, None if virtual else robot))))
        return
    if not virtual:
        from operators.extras import require_extra

        require_extra("ur", "commanding a UR arm")
    _report(asyncio.run(_collect(chosen, None if virtual else robot, bus, parse_rows(rows), out)))


async def _planned(plan: "CollectionPlan", robot: str | None) -> "PlannedPath":
    """Return the path from the arm's pose; `robot` None: that of the virtual arm."""
    from connectors.sim.simulated_arm import start_pose
    from connectors.ur.ur_state import read_state
    from flows.lab.collection.stroke_plan import PlannedPath
    from flows.run.clocks import LoopClock

    if robot is None:
        return PlannedPath.of(plan, DOWN, start_pose(plan.surfaces[0].pose or DOWN))
    here = (await read_state(LoopClock(), robot)).pose
    return PlannedPath.of(plan, here, here)


async def _collect(
    plan: "CollectionPlan", robot: str | None, bus: str, rows: tuple[int, ...], out: Path
) -> "Collector":
    """Collect with a robot, or with the virtual arm if it is None."""
    from connectors import TakkTile, UrMotion
    from connectors.ur.ur_arm import UrArm
    from flows.lab.collection.collector import Collector, virtual_arm
    from flows.run.clocks import LoopClock

    path, clock = await _planned(plan, robot), LoopClock()
    if robot is None:
        note("the first start compiles the physics, which takes some seconds")
        moved = await virtual_arm(path, clock, fingers=tuple(range(len(rows))))
        collector = Collector(path, moved, moved.fingertips, moved.motion, out, clock, note)
    else:
        limits, touch = plan.limits, TakkTile(int(bus) if bus.isdigit() else bus, rows)
        arm = UrArm(robot, path.bounds, clock, watchdog=limits.watchdog, path_tolerance=limits.margin)
        collector = Collector(path, arm, touch, UrMotion(robot), out, clock, note)
    await collector.collect()
    return collector


def _report(result: "Collector") -> None:
    """Print the summary of each session, and set the exit code: 1 if a session has a gap or lost rows."""
    for summary in result.summaries:
        typer.echo(summary.report())
    typer.echo(f"{result.strokes} strokes in {counted(len(result.summaries), 'session')}")
    if result.interrupted:
        typer.echo("interrupted; the arm has stopped where it is", err=True)
        raise typer.Exit(130)
    if result.error:
        typer.echo(f"error: {result.error}; the arm has stopped where it is", err=True)
        raise typer.Exit(2)
    gaps = [gap for each in result.summaries for source in each.sources.values() for gap in source.gaps]
    if gaps or any(each.error for each in result.summaries):
        raise typer.Exit(1)


def _path_text(path: "PlannedPath") -> str:
    """Return size, duration and bounds of a path, its workspace, and how it presses."""
    strokes, minutes = sum(len(each.strokes) for each in path.series), path.seconds / 60
    return "\n".join(
        [
            f"{counted(strokes, 'stroke')} in {counted(len(path.series), 'session')}, {minutes:.1f} min",
            f"path: {_spans(path.low, path.high)}",
            f"workspace: {_spans(path.bounds.low, path.bounds.high)}",
            f"pressed {1000 * path.plan.path.depth:g} mm after first contact",
        ]
    )


def _spans(low: "Point", high: "Point") -> str:
    spans = zip("xyz", low, high, strict=True)
    return ", ".join(f"{axis} {round(1000 * a)} to {round(1000 * b)} mm" for axis, a, b in spans)
