"""The command that drives an arm and records it."""

import asyncio
import json
import logging
import os
import signal
import sys
from contextlib import AsyncExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.options import AsJson
from flows.cli.terminal import note

if TYPE_CHECKING:
    from flows.lab.collection.arm_path import Pose
    from flows.lab.collection.collection_run import Collected, Rigging
    from flows.lab.collection.stroke_plan import StrokePlan
    from flows.lab.collection.surfaces import Spot

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

LEAST = 0.05  # s, of patience: a fingertip is read every 10 ms


def collect(
    plan: Annotated[
        str, typer.Argument(metavar="PLAN", help="paper: the paper's strokes; tiny: minutes, to try.")
    ],
    *,
    surface: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[:RADIUS][@X,Y,Z,RX,RY,RZ]",
            help="plane, sphere, cylinder_x or cylinder_y (its axis along that of the fingertip), radius of a"
            " curved one (as 60mm), and the TCP pose (m, rotation vector) at which the fingertip just touches"
            " its middle, the highest point; by default the pose that the arm has now, where it has to just"
            " touch then. May be repeated, each at a place of its own.",
        ),
    ] = None,
    robot: Annotated[str | None, typer.Option(metavar="HOST", help="Address of the UR controller.")] = None,
    touch: Annotated[str, typer.Option(metavar="BUS", help="I2C bus of the fingertips: 1, or a path.")] = "1",
    rows: Annotated[
        str, typer.Option(metavar="N,N", help="Rows of the fingertips on the bus, as 0,1.")
    ] = "0",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Dataset to record into.")] = Path("recordings"),
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the path, its duration and bounds; move nothing.")
    ] = False,
    virtual: Annotated[
        bool, typer.Option("--virtual", help="On a virtual lab of one's own, at --robot or 127.0.0.1.")
    ] = False,
    speeds: Annotated[
        str | None, typer.Option(metavar="SPEED,...", help="Of strokes, as 10mm/s,20mm/s; else the plan's.")
    ] = None,
    repeats: Annotated[int | None, typer.Option(help="Sessions of each speed; else the plan's.")] = None,
    rotations: Annotated[int | None, typer.Option(help="Sessions of rotations; else the plan's.")] = None,
    rounds: Annotated[
        int | None, typer.Option(help="Of eight strokes in each session; else the plan's.")
    ] = None,
    depth: Annotated[
        str | None,
        typer.Option(metavar="LENGTH", help="To press beyond the first touch, 6mm at most; else 1.5mm."),
    ] = None,
    force: Annotated[
        str | None,
        typer.Option(
            metavar="FORCE",
            help="To press with instead of to a depth, as 2N: each stroke comes down slowly until the arm"
            " feels it. A CB3 arm guesses its force from its currents, within 10 N or so; an e-Series arm"
            " measures it.",
        ),
    ] = None,
    deepest: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH", help="Beyond the first touch, where the force has to be felt at last; else 4mm."
        ),
    ] = None,
    unfelt: Annotated[
        bool, typer.Option("--unfelt", help="Go on though a fingertip feels nothing of a stroke.")
    ] = False,
    workspace: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z,X,Y,Z",
            help="Corners of the box to stay in, m; else the path with 5 mm around it.",
        ),
    ] = None,
    force_limit: Annotated[
        str, typer.Option(metavar="FORCE", help="At the TCP, beyond which the arm is stopped.")
    ] = "50N",
    delay: Annotated[
        str,
        typer.Option(metavar="TIME", help="Label each touch by the arm's motion this much later, as 70ms."),
    ] = "0s",
    patience: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="Without a reading, after which the arm is stopped, 50ms at least; else 300ms, with"
            " --virtual 2s.",
        ),
    ] = None,
    watchdog: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            help="Hz at which the controller must hear of us, else it stops the arm; else 5, with --virtual"
            " 0.5: a busy host holds a simulation up, and that is no danger.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the order of directions, and of a virtual lab.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Drive the arm through a collection plan and record it.

    That gives a dataset, labelled and split. The fingertip has to just touch the surface when it begins,
    unless --surface says where that is. Each stroke comes down, rests, slides, rests and goes up. Ctrl-C
    stops the arm first and then commits; SIGUSR1 pauses, and a second one goes on. The arm is stopped for
    good on a stop of the controller, at the workspace's bounds, by too much force, and when a fingertip is
    not felt any more, or feels nothing of a stroke.

    Examples:
      slipflow collect tiny --dry-run --robot 10.0.0.2
      slipflow collect tiny --virtual --out lab
      slipflow collect paper --robot 10.0.0.2 --force 2N --speeds 0.01,0.02
      slipflow collect tiny --robot 10.0.0.2 --surface sphere:60mm@0.4,0,0.1,3.1416,0,0
    """
    from connectors.ur.control_process import WATCHDOG
    from flows.graph.quantity import quantity, time
    from flows.lab.collection import collection_report as report
    from flows.lab.collection import collection_run as live
    from flows.lab.collection import plan_syntax as text
    from flows.lab.collection.collector import PATIENCE
    from flows.lab.collection.stroke_plan import named
    from flows.lab.collection.surfaces import apart

    with suppress(ValueError):  # not in the main thread
        signal.signal(signal.SIGUSR1, signal.SIG_IGN)  # deadly before and after the drive, else
    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr)
    chosen = named(plan)
    changed = replace(
        chosen,
        speeds=chosen.speeds if speeds is None else text.speeds(speeds),
        repeats=chosen.repeats if repeats is None else repeats,
        rotations=chosen.rotations if rotations is None else rotations,
        rounds=chosen.rounds if rounds is None else rounds,
        depth=chosen.depth if depth is None else quantity("collect", "--depth", depth, "m"),
        force=None if force is None else quantity("collect", "--force", force, "N"),
        deepest=chosen.deepest if deepest is None else quantity("collect", "--deepest", deepest, "m"),
    )
    limit = quantity("collect", "--force-limit", force_limit, "N")
    _check_pressing(changed, limit=limit, depth=depth, deepest=deepest)
    surfaces = apart([text.surface(each) for each in surface or ["plane"]])
    if virtual and len(surfaces) > 1:
        raise typer.BadParameter("--virtual: a virtual lab has one surface: record one after the other")
    if robot is None and not virtual and not dry_run:
        raise typer.BadParameter("give --robot HOST, or --virtual for a virtual lab, or --dry-run")
    box = None if workspace is None else text.box(workspace)
    rigging = live.Rigging(
        robot or "127.0.0.1",
        out,
        int(touch) if touch.isdigit() else touch,
        tuple(int(row) for row in text.numbers("--rows", rows)),
        box,
        0.03 if virtual else live.MARGIN,  # m; a host that is held up stops a virtual arm late
        limit,
        delay=time("collect", "--delay", delay),
        patience=_patience(patience, 2.0 if virtual else PATIENCE),
        watchdog=watchdog or (0.5 if virtual else WATCHDOG),
        blind=unfelt,
    )
    if dry_run:
        found = _dry(changed, surfaces, rigging, robot, seed, virtual=virtual)
        typer.echo(json.dumps(found) if as_json else report.as_table(found))
        return
    note(f"pause, and go on: kill -USR1 {os.getpid()}")
    done = asyncio.run(_collect(changed, plan, surfaces, rigging, seed, virtual=virtual))
    collected = report.summary(done.runs, done.strokes)
    collected["error"] = done.error or None
    typer.echo(json.dumps(collected) if as_json else report.as_text(collected))
    if done.interrupted:
        typer.echo("interrupted; the arm stands where it is", err=True)
        raise typer.Exit(130)
    if done.error:
        typer.echo(f"error: {done.error}; the arm stands where it is", err=True)
        raise typer.Exit(2)
    if any(each["dropped"] or each["gaps"] for each in collected["sessions"]):
        raise typer.Exit(1)


async def _collect(
    plan: "StrokePlan",
    name: str,
    surfaces: "list[Spot]",
    rigging: "Rigging",
    seed: int,
    *,
    virtual: bool,
) -> "Collected":
    from connectors.emulators.virtual_lab import virtual_lab
    from connectors.sim.scene import commanded_scene
    from flows.lab.collection import collection_run as live

    async with AsyncExitStack() as running:
        if virtual:
            note("starting the virtual lab; the first time, its physics is compiled for some seconds")
            scene = commanded_scene(surfaces[0].curvature, surfaces[0].radius)
            lab = await running.enter_async_context(
                virtual_lab(scene, seed, fingers=rigging.rows, host=rigging.robot)
            )
            rigging = replace(rigging, bus=lab.bus)
            surfaces = [each._replace(place=each.place or _middle()) for each in surfaces]
        return await live.collect(plan, surfaces, rigging, name=name, seed=seed, told=note)


def _check_pressing(plan: "StrokePlan", *, limit: float, depth: str | None, deepest: str | None) -> None:
    """Say which options do not go together."""
    if plan.force is None and deepest is not None:
        raise typer.BadParameter("--deepest is for --force: --depth says how deep to press without")
    if plan.force is not None and depth is not None:
        raise typer.BadParameter("give --depth or --force, not both")
    if plan.force is not None and plan.force >= limit:
        raise typer.BadParameter(f"--force {plan.force:g}N: must be below the --force-limit, {limit:g}N")


def _patience(text: str | None, usual: float) -> float:
    """S without a reading, after which the arm is stopped."""
    from flows.graph.quantity import quantity

    seconds = usual if text is None else quantity("collect", "--patience", text, "ns") / 1e9
    if seconds < LEAST:
        raise typer.BadParameter(f"--patience {text}: must be 50ms or more")
    return seconds


def _dry(
    plan: "StrokePlan",
    surfaces: "list[Spot]",
    rigging: "Rigging",
    robot: str | None,
    seed: int,
    *,
    virtual: bool,
) -> "dict[str, object]":
    """The plan from where the arm is, if there is one to ask, and within the bounds that it would have."""
    from connectors.emulators.virtual_lab import HEIGHT
    from flows.lab.collection.collection_report import planned
    from flows.lab.collection.collection_run import room, where
    from flows.run.clocks import LoopClock

    async def ask(robot: str) -> "Pose":
        return await where(robot, LoopClock())

    middle, here = _middle(), None
    if virtual:
        here = (*middle[:2], HEIGHT, *middle[3:])
    elif robot is not None:
        middle = here = asyncio.run(ask(robot))
    else:
        note("without --robot or --virtual, where the arm is now is unknown: the way from there is left out")
        if any(each.place is None for each in surfaces):
            note("and the plan is laid around the origin of its base frame")
    sessions = plan.sessions([each.surface(middle) for each in surfaces], seed)
    return planned(sessions, *room(sessions, here, rigging.workspace, rigging.margin), here)


def _middle() -> "Pose":
    """Where a fingertip that looks down touches the middle of a virtual lab's surface."""
    from math import pi

    return 0.0, 0.0, 0.0, pi, 0.0, 0.0
