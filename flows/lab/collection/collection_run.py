"""A plan on a rig: where everything is, within which bounds it moves, and what came of it."""

import asyncio
import signal
from collections.abc import Callable, Sequence
from contextlib import aclosing
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final, cast

from connectors import TakkTile, UrMotion
from connectors.takktile.i2c_access import I2cBus
from connectors.ur.control_process import WATCHDOG
from connectors.ur.ur_arm import UrArm
from connectors.ur.ur_state import ArmStateReader, Bounds
from flows.lab.collection.arm_path import Place, Pose
from flows.lab.collection.collector import APPEAR, PATIENCE, Collection
from flows.lab.collection.signal_handlers import answered
from flows.lab.collection.stroke_plan import Session, StrokePlan, extent
from flows.lab.collection.surfaces import Spot
from flows.run.clocks import LoopClock
from operators import ParameterError, Run
from operators.errors import EndpointError
from operators.ports import Clock
from storage import Dataset

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator

    from operators import Touch

MARGIN: Final = 0.005  # m

Box = tuple[Place, Place]  # m: lowest and highest corner, base frame


@dataclass(frozen=True)
class Rigging:
    """Where everything is.

    Attributes:
        robot: Address of the arm's controller.
        bus: Of the fingertips; see `TakkTile`.
        rows: Of the fingertips.
        out: The dataset.
        workspace: That the arm is kept in; None: its planned path, with a margin.
        margin: Around the path, where no workspace is given, and aside of it, m.
        force: At the TCP, beyond which the arm is stopped, N.
        rate: Hz of the arm's motion, as recorded.
        delay: See `flows.lab.collection.collector.declare`, ns.
        patience: Without a reading of a fingertip, after which the arm is stopped, s.
        watchdog: See `UrArm`, Hz.
        blind: Go on though a fingertip feels nothing of a stroke.
    """

    robot: str
    out: Path
    bus: int | str | I2cBus = 1
    rows: tuple[int, ...] = (0,)
    workspace: Box | None = None
    margin: float = MARGIN
    force: float = 50.0
    rate: float = 125.0
    delay: int = 0
    patience: float = PATIENCE
    watchdog: float = WATCHDOG
    blind: bool = False


@dataclass(frozen=True)
class Collected:
    """What came of it."""

    runs: list[Run]
    strokes: int
    error: str  # why the arm was stopped; empty: it was not
    interrupted: bool


async def collect(
    plan: StrokePlan,
    surfaces: Sequence[Spot],
    rigging: Rigging,
    *,
    name: str,
    seed: int = 0,
    told: Callable[[str], None] = lambda _: None,
) -> Collected:
    """Carry out a plan and record it. SIGUSR1 pauses, and again goes on; SIGINT stops the arm, then the rest.

    Args:
        plan: What to do on each surface.
        surfaces: On which.
        rigging: Where everything is.
        name: Of the plan.
        seed: Of what is drawn.
        told: Told what is being done.

    Raises:
        EndpointError: if the rig is not ready; nothing has moved then.
        ParameterError: if the path leaves the workspace.
        SlipflowError: if a session cannot be recorded; the arm stands.
    """
    clock = LoopClock()
    here = await where(rigging.robot, clock)
    found = [spot.surface(here) for spot in surfaces]
    sessions = plan.sessions(found, seed)
    low, high = room(sessions, here, rigging.workspace, rigging.margin)
    touch = TakkTile(rigging.bus, rigging.rows)
    await look(touch, clock)
    await asyncio.to_thread(import_module, "storage.writer")  # takes long, and would hold up the run
    bounds, stray = Bounds(low, high, rigging.force), rigging.margin
    arm = UrArm(rigging.robot, bounds, clock, watchdog=rigging.watchdog, path_tolerance=stray)
    collection = Collection(
        arm,
        touch,
        UrMotion(rigging.robot, rigging.rate),
        lambda: Dataset(rigging.out),
        clock,
        {"plan": name, "seed": seed, "workspace": [*low, *high], "force_limit": rigging.force},
        delay=rigging.delay,
        patience=rigging.patience,
        blind=rigging.blind,
        told=told,
    )
    error, stop = "", collection.interrupt
    acts = {signal.SIGINT: stop, signal.SIGTERM: stop, signal.SIGUSR1: collection.pause_or_resume}
    with answered(acts):
        try:
            async with arm:
                await collection.collect(sessions)
        except EndpointError as stopped:
            if not arm.fault or not (collection.runs or collection.interrupted):
                raise
            error = str(stopped)
    return Collected(collection.runs, collection.driver.strokes, error, collection.interrupted)


async def look(touch: TakkTile, clock: Clock) -> None:
    """See that the fingertips are there.

    Raises:
        EndpointError: if no reading comes.
    """
    batches = cast("AsyncGenerator[Touch]", touch.batches(clock))
    try:
        async with asyncio.timeout(APPEAR), aclosing(batches):
            await anext(batches)
    except TimeoutError as error:
        raise EndpointError(touch.path, f"gives no reading for {APPEAR:g} s") from error


async def where(robot: str, clock: Clock) -> Pose:
    """The pose at which an arm is now.

    Raises:
        EndpointError: if its controller does not tell.
    """
    watch = ArmStateReader(clock, robot)
    try:
        x, y, z, a, b, c = (await watch.open()).pose
    finally:
        await watch.close()
    return x, y, z, a, b, c


def room(
    sessions: Sequence[Session], here: Pose | None, workspace: Box | None, margin: float = MARGIN
) -> Box:
    """The workspace: as given, or the path's bounds, from where the arm is now, with a margin.

    Raises:
        ParameterError: if the path leaves the one that is given.
    """
    reach = extent(sessions, here)
    if workspace is None:
        a, b, c = (each - margin for each in reach.low)
        d, e, f = (each + margin for each in reach.high)
        return (a, b, c), (d, e, f)
    low, high = workspace
    for axis, a, b, c, d in zip("xyz", low, reach.low, reach.high, high, strict=True):
        if not a <= b <= c <= d:
            must_be = f"around the path, which goes from {b:.4f} to {c:.4f} m along {axis}"
            raise ParameterError("collect", "workspace", [*low, *high], must_be)
    return workspace
