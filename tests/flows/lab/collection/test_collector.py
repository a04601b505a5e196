"""Collections with the simulated arm, in virtual time."""

import asyncio
import json
import math
import re
import signal
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import pytest
import typer

from connectors.sim.finger import Finger
from connectors.sim.scene import NO_VIBRATION
from connectors.sim.simulated_arm import STIFFNESS, SimulatedArm, start_pose
from connectors.ur.ur_state import Pose
from flows.cli.collect import _report
from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.graph.testing import VirtualLoop, run_virtually
from flows.lab.collection.arm_path import Surface
from flows.lab.collection.collector import LEAST_CHANGE, Collector, ContactMonitor, virtual_arm
from flows.lab.collection.stroke_plan import CollectionPlan, Limits, PathSettings, PlannedPath, StrokeSeries
from flows.relabel import relabel
from flows.run.clocks import LoopClock
from flows.run.replay_runner import ReplayRunner
from operators import (
    EVERY,
    SLIP,
    UNKNOWN,
    EndpointError,
    Labelled,
    Motion,
    ParameterError,
    Run,
    Touch,
    Truth,
    concat,
    s,
)
from operators.batch import Curvature
from storage import Dataset, Session

PLACE: Pose = (0.4, -0.1, 0.2, 3.0, 0.4, 0.1)  # the arm does not look straight down
PATH = PathSettings(
    slide_time=0.4,
    rotation_time=0.4,
    rest=0.1,
    baseline=1.2,
    clearance=0.004,
    travel_speed=0.3,
    press_speed=0.1,
    acceleration=1.0,
)
STROKES = 2


@dataclass(frozen=True)
class ShortPlan(CollectionPlan):
    """Plan with the first strokes of each series only."""

    count: int = STROKES

    def series(self, here: Pose) -> list[StrokeSeries]:
        whole = CollectionPlan.series(self, here)
        return [replace(each, strokes=each.strokes[: self.count]) for each in whole]


QUICK = ShortPlan("quick", (0.1,), repeats=1, rotations=0, rounds=1, seed=1, path=PATH)
ROTATIONS = ShortPlan("rotations", (), rotations=1, rounds=1, path=PATH)
CURVED = ShortPlan("curved", (0.05,), repeats=1, rotations=0, rounds=1, path=PATH)


class Made(NamedTuple):
    collected: Collector
    truth: Truth
    out: Path

    @property
    def session(self) -> Session:
        return Session.open(self.out / "sessions" / self.collected.summaries[0].session)

    @property
    def about(self) -> dict[str, Any]:
        about: dict[str, Any] = json.loads((self.session.folder / "session.json").read_text())
        return about


def made(
    out: Path,
    plan: CollectionPlan = QUICK,
    act: Callable[[SimulatedArm], None] | None = None,
    *,
    surface: Curvature = "plane",
    above: float = 0.0,
    steady: bool = False,
) -> Made:
    """Collect with a simulated arm, and call `act` 0.5 s after the first contact.

    The plan's surface is `above` (m) the real one; an arm that is steady does not vibrate.
    """
    truth, sense = list[Truth](), Finger.sense

    def record(finger: Finger, instant: float) -> tuple[Touch, Truth]:
        touch, true = sense(finger, instant)
        truth.append(true)
        return touch, true

    async def act_in_contact(arm: SimulatedArm) -> None:
        while not np.any(arm.state.force):  # noqa: ASYNC110 - no event for it
            await asyncio.sleep(0.02)
        await asyncio.sleep(0.5)
        if act:
            act(arm)

    async def main() -> Made:
        clock = LoopClock(1_700_000_000 * s)
        surfaces = (Surface(surface, pose=PLACE),)
        path = PlannedPath.of(replace(plan, surfaces=surfaces), PLACE, start_pose(PLACE))
        arm = await virtual_arm(path, clock)
        arm._surface = path.series[0].surface.at(0.0, 0.0, above)
        if steady:
            for finger in arm._fingertips:
                finger._scene = replace(finger._scene, vibration=NO_VIBRATION)
        collector = Collector(path, arm, arm.fingertips, arm.motion, out, clock)
        acting = asyncio.create_task(act_in_contact(arm))
        await collector.collect()
        acting.cancel()
        await asyncio.sleep(0.1)
        velocity = np.abs(arm.state.velocity).max()
        assert velocity == 0.0, "the arm stands"
        true = concat(Truth, truth)
        return Made(collector, replace(true, time=true.time + clock._start), out)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Finger, "sense", record)
        return run_virtually(main())


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Made:
    return made(tmp_path_factory.mktemp("quick") / "data", steady=True)


def test_all_strokes_are_recorded_completely(quick: Made) -> None:
    collected = quick.collected
    assert (collected.strokes, collected.error, collected.interrupted) == (QUICK.count, "", False)
    assert quick.about["complete"]
    touch = concat(Touch, list(quick.session.read(Touch, 0)))
    motion = concat(Motion, list(quick.session.read(Motion, EVERY)))
    assert touch.valid.all()
    assert (np.diff(touch.time) == s // 100).all()
    assert (np.diff(motion.device_time) == s // 125).all()
    assert not collected.summaries[0].sources["touch"].gaps


def test_a_recording_that_could_not_be_ended_fails_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    close = Dataset.close

    async def close_with_error(dataset: Dataset) -> None:
        await close(dataset)
        raise EndpointError("disk", "is full")

    monkeypatch.setattr(Dataset, "close", close_with_error)
    collected = made(tmp_path / "data", steady=True).collected
    assert [sink.dropped for sink in collected.summaries[0].sinks.values()] == [0, 0]
    with pytest.raises(typer.Exit) as ended:
        _report(collected)
    assert ended.value.exit_code == 1
    assert "s; dataset: disk: is full" in capsys.readouterr().out


def test_labels_equal_the_ground_truth_within_one_sample(quick: Made) -> None:
    labelled, truth = concat(Labelled, list(quick.session.read(Labelled, 0))), quick.truth
    nearest = truth.time.searchsorted(labelled.time)
    velocity = truth.velocity[nearest]  # (n, 3)
    slips = np.hypot(velocity[:, 0], velocity[:, 1]) > 0.003  # (n,)
    around = np.stack([np.roll(slips, shift) for shift in (-1, 0, 1)])
    known = labelled.label != UNKNOWN
    assert (around == (labelled.label == SLIP)).any(axis=0)[known].all()
    assert (labelled.label[known] == SLIP).sum() > QUICK.count * 30
    assert (truth.force[nearest] > 0)[labelled.label == SLIP].all()  # what the arm does in the air is no slip


def test_episodes_has_a_row_for_every_stroke(quick: Made) -> None:
    air, *strokes = quick.session.frame("episodes").to_dicts()
    assert air["motion"] == "hold"
    turns = {each["direction"] / (math.pi / 4) for each in strokes}
    assert len(turns) == len(strokes) == QUICK.count
    assert all(turn == pytest.approx(round(turn)) for turn in turns)
    labelled = concat(Labelled, list(quick.session.read(Labelled, 0)))
    for each in strokes:
        assert (each["motion"], each["speed"], each["surface"]) == ("translation", 0.1, "plane")
        inside = (labelled.time >= each["time"]) & (labelled.time < each["end"])
        assert (labelled.label[inside] == SLIP).sum() > 30
        assert (labelled.label[inside] == UNKNOWN).sum() == 0


def test_session_json_has_the_plan(quick: Made) -> None:
    collection = quick.about["sources"]["collection"]
    assert (collection["plan"], collection["surface"], collection["speed"]) == ("quick", "plane", 0.1)
    assert collection["place"] == list(PLACE)
    assert quick.about["split"] in ("train", "validation", "test")
    assert quick.about["sources"]["touch"]["sensor"] == "TakkTile 2x3, simulated"
    assert "MaskLifted" in " ".join(quick.about["declaration"])


def test_rotations_slip_and_air_moves_do_not_also_if_labelled_again(tmp_path: Path) -> None:
    done = made(tmp_path / "data", ROTATIONS)
    assert (done.collected.strokes, done.collected.error) == (STROKES, "")
    labelled = concat(Labelled, list(done.session.read(Labelled, 0)))
    assert (labelled.label == SLIP).sum() > STROKES * 20
    flow = relabel(str(tmp_path / "again"), "psd", delay=0, surface=",".join(map(str, PLACE)))
    asyncio.run(ReplayRunner(flow, done.session, "again").execute())
    again = concat(Labelled, list(Session.open(tmp_path / "again/sessions/again").read(Labelled, 0)))
    assert np.array_equal(again.label, labelled.label)
    air, first, last = done.session.frame("episodes").to_dicts()
    assert [each["motion"] for each in (air, first, last)] == ["hold", "rotation", "rotation"]
    assert first["angular_speed"] == -last["angular_speed"]


def test_depth_and_speed_are_kept_over_a_sphere(tmp_path: Path) -> None:
    curved = made(tmp_path / "data", CURVED, surface="sphere")
    about = curved.about["sources"]["collection"]
    assert (about["depth"], about["radius"]) == (CURVED.path.depth, 0.06)
    assert (curved.collected.strokes, curved.collected.error) == (STROKES, "")
    motion = concat(Motion, list(curved.session.read(Motion, EVERY)))
    _, *strokes = curved.session.frame("episodes").to_dicts()
    assert len(strokes) == STROKES
    for each in strokes:
        force = curved.truth.force[(curved.truth.time >= each["time"]) & (curved.truth.time < each["end"])]
        assert each["depth"] == CURVED.path.depth
        np.testing.assert_allclose(force, STIFFNESS * CURVED.path.depth, rtol=0.05)
        inside = (motion.time >= each["time"]) & (motion.time < each["end"])
        speed = np.linalg.norm(motion.velocity[inside, :3], axis=1)  # (n,)
        assert speed.max() < 1.001 * 0.05
        assert (speed > 0.999 * 0.05).sum() / 125 > 0.7 * PATH.slide_time


def unplug(arm: SimulatedArm) -> None:
    arm._fingertips = []


def press_ctrl_c(_: SimulatedArm) -> None:
    signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize(
    ("act", "why"), [(unplug, "gave no sample for 0.3 s"), (press_ctrl_c, "interrupted")]
)
def test_an_interruption_stops_the_arm_and_commits(
    tmp_path: Path, act: Callable[[SimulatedArm], None], why: str
) -> None:
    done = made(tmp_path / "data", act=act)
    assert why in done.collected.error
    assert done.collected.interrupted == (act is press_ctrl_c)
    with pytest.raises(typer.Exit) as ended:
        _report(done.collected)
    assert ended.value.exit_code == (130 if act is press_ctrl_c else 2)
    assert done.collected.strokes < QUICK.count
    assert not done.about["complete"]
    assert why in done.about["error"]
    touch = concat(Touch, list(done.session.read(Touch, 0)))
    assert touch.time[-1] - touch.time[0] > 1.5 * s
    assert done.session.frame("episodes")["end"][-1] <= done.about["end_ns"]


def test_a_stall_of_the_host_is_no_silence_of_a_fingertip(tmp_path: Path) -> None:
    def stall(_: SimulatedArm) -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        loop.stall(2 * QUICK.limits.sensor_timeout)

    assert not made(tmp_path / "data", act=stall).collected.error


def test_too_much_force_stops_the_arm(tmp_path: Path) -> None:
    weak = replace(QUICK, limits=Limits(force=1.0))
    assert re.search(r"a force of 1\.\d N, more than 1 N", made(tmp_path / "data", weak).collected.error)


def test_a_stroke_in_the_air_ends_the_collection(tmp_path: Path) -> None:
    done = made(tmp_path / "data", above=0.003)
    assert "fingertip 0 measured no contact in a stroke" in done.collected.error
    assert "fingertip 0 measured no contact in a stroke" in done.about["error"]
    assert not done.about["complete"]
    assert len(done.session.frame("episodes")) == 2  # the air, and one stroke


class Sampled(SimulatedArm):
    """Arm whose fingertips give no sample, and which must not be commanded."""

    async def __aenter__(self) -> Self:
        raise AssertionError("commanded")


def test_nothing_moves_without_a_sensor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def silent(*_: object) -> AsyncIterator[Touch]:
        yield pressed(400, 0, valid=False)
        await asyncio.sleep(math.inf)

    monkeypatch.setattr("connectors.sim.simulated_arm.SimulatedArm._touch", silent)
    monkeypatch.setattr("flows.lab.collection.collector.SimulatedArm", Sampled)
    with pytest.raises(EndpointError, match="fingertip 0 gives no sample within 10 s"):
        made(tmp_path / "data")
    assert not list(tmp_path.iterdir())


def test_a_fingertip_without_samples_in_a_session_stops_the_arm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started, touch = count(), SimulatedArm._touch

    async def once(arm: SimulatedArm, clock: LoopClock) -> AsyncIterator[Touch]:
        if next(started):
            await asyncio.sleep(math.inf)
        async for sample in touch(arm, clock):
            yield sample

    monkeypatch.setattr(SimulatedArm, "_touch", once)
    assert "fingertip 0 gave no sample for 10 s" in made(tmp_path / "data").collected.error


def test_operators_are_compiled_before_the_arm_is_commanded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def compiled(_: Flow) -> CompiledFlow:
        raise AssertionError("compiled")

    monkeypatch.setattr("flows.lab.collection.collector.SimulatedArm", Sampled)
    monkeypatch.setattr("flows.lab.collection.collector.CompiledFlow", compiled)
    with pytest.raises(AssertionError, match="compiled"):
        made(tmp_path / "data")


def test_a_path_outside_the_workspace_is_refused() -> None:
    down: Pose = (0.0, 0.0, 0.0, math.pi, 0.0, 0.0)

    def planned(limits: Limits, here: Pose = down) -> PlannedPath:
        return PlannedPath.of(replace(QUICK, seed=0, count=4, limits=limits), down, here)

    with pytest.raises(ParameterError, match=r"from -0\.0200 to 0\.0200 m along x"):
        planned(Limits(workspace=(-0.01, -1.0, -1.0, 0.01, 1.0, 1.0)))
    with pytest.raises(ParameterError, match="along z"):  # where the arm is now counts
        planned(Limits(workspace=(-0.1, -0.1, -0.1, 0.1, 0.1, 0.1)), (0, 0, 0.5, math.pi, 0, 0))
    bounds = planned(Limits(margin=0.01)).bounds
    np.testing.assert_allclose(
        (bounds.low, bounds.high), ((-0.03, -0.03, -0.0115), (0.03, 0.03, 0.014)), atol=1e-9
    )


def pressed(counts: float, finger: int, *, valid: bool = True) -> Touch:
    """Return ten samples; cell 3 has about so many counts, the others 500."""
    cells = np.full((10, 6), 500) + np.tile([-1, 1], 5)[:, None]
    cells[:, 3] += round(counts) - 500
    cells = cells.astype(np.int16)
    return Touch(np.arange(10), cells, cells, np.full((10, 6), valid), finger=finger)


def test_each_fingertip_is_judged_by_its_cell_that_changes_most(run: Run) -> None:
    """Finger 3 gives no valid sample, finger 4 gave none in the air."""
    changes = {0: 0, 1: LEAST_CHANGE - 1, 2: LEAST_CHANGE, 3: 0, 5: -40}

    async def main() -> ContactMonitor:
        monitor = ContactMonitor()
        await monitor.open(run)
        for finger in changes:
            await monitor.write(pressed(400, finger))
        monitor.set_baseline()
        monitor.restart()
        for finger, change in {**changes, 4: 0}.items():
            await monitor.write(pressed(400 + change, finger, valid=finger != 3))
        return monitor

    monitor = asyncio.run(main())
    assert monitor.without_contact() == [0, 1]
    assert monitor.newest == dict.fromkeys(changes | {4: 0}, 9)
