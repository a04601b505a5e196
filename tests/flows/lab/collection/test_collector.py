"""Collections on the virtual lab, whose controller is commanded by ur-rtde."""

import asyncio
import importlib.util
import json
import math
import signal
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Self, cast

import numpy as np
import pytest

from connectors.emulators.i2c_bus import VIRTUAL
from connectors.emulators.lab_loop import run_lab
from connectors.emulators.virtual_lab import VirtualLab, virtual_lab
from connectors.sim.commanded_motion import STIFFNESS
from connectors.sim.scene import Curvature, commanded_scene
from connectors.ur.ur_arm import UrArm
from connectors.ur.ur_state import Pose
from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.lab.collection.collector import Collector, collect, workspace
from flows.lab.collection.stroke_plan import (
    CollectionPlan,
    Limits,
    PathSettings,
    Press,
    StrokeSeries,
)
from flows.lab.collection.surfaces import Surface
from flows.run.clocks import LoopClock
from operators import (
    EVERY,
    SLIP,
    UNKNOWN,
    Clocks,
    EndpointError,
    Labelled,
    Motion,
    ParameterError,
    Touch,
    Truth,
    WatchClock,
    concat,
    s,
)
from storage import Session
from tests.connectors.emulators.observed_scene import ObservedScene
from tests.loopback import own_host

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("rtde_control") is None, reason="needs the extra `ur`"
)

HOST = own_host(3)
PLACE: Pose = (0.0, 0.0, 0.0, math.pi, 0.0, 0.0)
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
FORCE = 1.5  # N
STROKES = 2


@dataclass(frozen=True)
class ShortPlan(CollectionPlan):
    """Plan with the first strokes of each series only."""

    count: int = STROKES

    def series(self, here: Pose, seed: int) -> list[StrokeSeries]:
        whole = CollectionPlan.series(self, here, seed)
        return [replace(each, strokes=each.strokes[: self.count]) for each in whole]


QUICK = ShortPlan("quick", speeds=(0.1,), repeats=1, rotations=0, rounds=1, path=PATH, count=4)
ROTATIONS = ShortPlan("rotations", speeds=(), rotations=1, rounds=1, path=PATH)
PRESSED = ShortPlan(
    "pressed",
    speeds=(0.05,),
    repeats=1,
    rotations=0,
    rounds=1,
    path=PATH,
    press=Press(force=FORCE, max_depth=0.0025, search_height=0.0005, search_speed=0.004, tare_time=0.1),
)


class Made(NamedTuple):
    collected: Collector
    truth: Truth
    out: Path

    @property
    def session(self) -> Session:
        return Session.open(self.out / "sessions" / self.collected.runs[0].session)

    @property
    def about(self) -> dict[str, Any]:
        about: dict[str, Any] = json.loads((self.session.folder / "session.json").read_text())
        return about


def made(
    out: Path,
    plan: CollectionPlan = QUICK,
    act: Callable[[VirtualLab], None] | None = None,
    *,
    pressed: bool = True,
    surface: Curvature = "plane",
    place: Pose = PLACE,
) -> Made:
    """Collect on a virtual lab; call `act` 0.8 s after the first press, or at once without `pressed`."""

    async def do(lab: VirtualLab) -> None:
        while pressed and not cast("Any", lab.controller.box.values(["actual_TCP_pose"])[0])[2] < 0:  # noqa: ASYNC110
            await asyncio.sleep(0.02)
        if act:
            asyncio.get_running_loop().call_later(pressed * 0.8, act, lab)

    async def main() -> Made:
        still = replace(commanded_scene(surface), vibration=None)  # so that an arm at rest has no speed
        async with virtual_lab(still, host=HOST) as lab:
            lab.wait_for_commands()
            limits = Limits(margin=0.05, sensor_timeout=1.0, watchdog=0.1)  # for a busy host
            surfaces = (Surface(surface, pose=place),)
            planned = replace(plan, limits=limits, surfaces=surfaces)
            acting = asyncio.create_task(do(lab))
            async with asyncio.timeout(120):
                collected = await collect(
                    planned, HOST, out, bus=lab.bus, seed=1, clock=LoopClock(lab.scene.now())
                )
            acting.cancel()
            lab.scene.advance(lab.scene.now())  # to see that the arm stands
            return Made(collected, cast("ObservedScene", lab.scene).truth(), out)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("connectors.emulators.virtual_lab.SharedScene", ObservedScene)
        return run_lab(main())


def unplug(lab: VirtualLab) -> None:
    """Take the fingertips off the bus."""
    lab.bus.fingertips = {}


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Made:
    return made(tmp_path_factory.mktemp("quick") / "data")


def test_all_strokes_are_recorded_completely(quick: Made) -> None:
    collected = quick.collected
    assert (collected.driver.strokes, collected.error, collected.interrupted) == (QUICK.count, "", False)
    assert quick.about["complete"]
    touch = concat(Touch, list(quick.session.read(Touch, 0)))
    motion = concat(Motion, list(quick.session.read(Motion, -1)))
    assert touch.valid.all()
    assert (np.rint(np.diff(motion.device_time) / 8e6) == 1).all()  # every package once
    assert not collected.runs[0].sources["touch"].gaps


def test_the_arms_clock_is_recorded(quick: Made) -> None:
    clocks = concat(Clocks, list(quick.session.read(Clocks, EVERY)))
    motion = concat(Motion, list(quick.session.read(Motion, EVERY)))
    watch = WatchClock()
    again = concat(Clocks, [watch.push(motion), watch.flush()])
    assert len(clocks) == np.ptp(motion.device_time) // (5 * s) + 1
    for name in ("time", "offset", "drift", "residual"):
        np.testing.assert_array_equal(getattr(clocks, name), getattr(again, name))


def test_labels_equal_the_ground_truth_within_one_sample(quick: Made) -> None:
    labelled, truth = concat(Labelled, list(quick.session.read(Labelled, 0))), quick.truth
    newer = np.clip(truth.time.searchsorted(labelled.time), 1, len(truth) - 1)  # (n,)
    nearest = newer - (labelled.time - truth.time[newer - 1] < truth.time[newer] - labelled.time)
    velocity = truth.velocity[nearest]  # (n, 3)
    slips = np.hypot(velocity[:, 0], velocity[:, 1]) > 0.003  # (n,)
    around = np.stack([np.roll(slips, shift) for shift in (-1, 0, 1)])
    known = labelled.label != UNKNOWN
    agrees = (around == (labelled.label == SLIP)).any(axis=0)
    assert agrees[known].all()
    assert (labelled.label[known] == SLIP).sum() > QUICK.count * 30
    pressed = truth.force[nearest] > 0
    assert pressed[labelled.label == SLIP].all()  # what the arm does in the air is no slip


def test_episodes_has_a_row_for_every_stroke(quick: Made) -> None:
    air, *strokes = quick.session.frame("episodes").to_dicts()
    assert air["motion"] == "hold"
    turns = {each["direction"] / (math.pi / 4) for each in strokes}
    assert len(turns) == len(strokes) == QUICK.count
    assert all(turn == pytest.approx(round(turn)) for turn in turns)
    for each in strokes:
        assert (each["motion"], each["speed"], each["surface"]) == ("translation", 0.1, "plane")
    assert quick.about["split"] in ("train", "validation", "test")
    labelled = concat(Labelled, list(quick.session.read(Labelled, 0)))
    for each in strokes:
        inside = (labelled.time >= each["time"]) & (labelled.time < each["end"])
        slipping = labelled.time[inside & (labelled.label == SLIP)]
        assert slipping[-1] - slipping[0] > 0.3 * s  # a busy host reads fewer rows
        assert (labelled.label[inside] == UNKNOWN).sum() == 0


def test_session_json_has_the_plan(quick: Made) -> None:
    collection = quick.about["sources"]["collection"]
    assert (collection["plan"], collection["surface"], collection["speed"]) == ("quick", "plane", 0.1)
    assert collection["place"] == list(PLACE)
    assert quick.about["sources"]["touch"]["sensor"] == "TakkTile 2x3"
    assert "MaskLifted" in " ".join(quick.about["declaration"])


@pytest.fixture(scope="module")
def turns(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Rotations, with a pause between."""

    def pause(_: VirtualLab) -> None:
        signal.raise_signal(signal.SIGUSR1)
        asyncio.get_running_loop().call_later(1.5, signal.raise_signal, signal.SIGUSR1)

    return made(tmp_path_factory.mktemp("turns") / "data", ROTATIONS, pause)


def test_rotations_slip_too(turns: Made) -> None:
    assert (turns.collected.driver.strokes, turns.collected.error) == (STROKES, "")
    labelled = concat(Labelled, list(turns.session.read(Labelled, 0)))
    assert (labelled.label == SLIP).sum() > STROKES * 20
    assert {each["motion"] for each in turns.session.frame("episodes").to_dicts()} == {"hold", "rotation"}


def test_sigusr1_pauses_and_resumes(turns: Made) -> None:
    assert (turns.collected.driver.strokes, turns.collected.error) == (STROKES, "")
    assert len(turns.session.frame("episodes")) - STROKES in (
        1,
        2,
    )  # with the interrupted one, if there was one
    assert turns.about["complete"]
    motion = concat(Motion, list(turns.session.read(Motion, -1)))
    standing = np.abs(motion.velocity).max(axis=1) < 1e-3  # (n,)
    ends = np.flatnonzero(np.diff(np.r_[0, standing, 0].astype(np.int8)))  # where it begins and ends to stand
    spans = np.diff(motion.time[np.minimum(ends, len(motion) - 1)])[::2]
    assert (spans > 0.9 * s).sum() >= 2  # in the air at first, and paused


@pytest.fixture(scope="module")
def pressed(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Strokes over a sphere, at a set force."""
    return made(tmp_path_factory.mktemp("pressed") / "data", PRESSED, surface="sphere")


def test_a_force_is_kept_over_a_sphere(pressed: Made) -> None:
    assert (pressed.collected.driver.strokes, pressed.collected.error) == (STROKES, "")
    _, *strokes = pressed.session.frame("episodes").to_dicts()
    assert len(strokes) == STROKES
    for each in strokes:
        inside = (pressed.truth.time >= each["time"]) & (pressed.truth.time < each["end"])
        force = pressed.truth.force[inside]
        assert force[0] >= 0.95 * FORCE
        assert force.min() > 0.75 * FORCE
        assert force.max() < 1.5 * FORCE


def test_the_speed_along_an_arc_is_kept(pressed: Made) -> None:
    motion = concat(Motion, list(pressed.session.read(Motion, -1)))
    _, *strokes = pressed.session.frame("episodes").to_dicts()
    for each in strokes:
        inside = (motion.time >= each["time"]) & (motion.time < each["end"])
        speed = np.linalg.norm(motion.velocity[inside, :3], axis=1)  # (n,)
        assert speed.max() < 1.03 * 0.05
        assert (speed > 0.97 * 0.05).sum() / 125 > 0.7 * PATH.slide_time
        low, high = (part(motion.pose[inside, 2]) for part in (np.min, np.max))
        assert high - low > 5e-4  # down the sides: 0.8 mm at 10 mm from its middle


def test_session_json_has_depth_and_force(quick: Made, pressed: Made) -> None:
    about = [made.about["sources"]["collection"] for made in (quick, pressed)]
    assert [(each["depth"], each["force"], each["radius"]) for each in about] == [
        (QUICK.press.depth, None, None),
        (None, FORCE, 0.06),
    ]
    planned, found = (made.session.frame("episodes")[1:] for made in (quick, pressed))
    assert planned["depth"].to_list() == [QUICK.press.depth] * QUICK.count
    assert planned["force"].is_nan().all()
    for each in found.to_dicts():
        assert 0.9 * FORCE < each["force"] < 1.4 * FORCE
        assert each["depth"] == pytest.approx(each["force"] / STIFFNESS, abs=1e-4)


def interrupted(done: Made, why: str) -> None:
    """Check that a collection ended early, with the arm at rest and the recorded part committed."""
    assert why in done.collected.error
    assert done.collected.driver.strokes < QUICK.count
    assert not done.about["complete"]
    assert why in done.about["error"]
    velocity = done.truth.velocity[-1]
    assert np.abs(velocity).max() < 1e-3
    touch = concat(Touch, list(done.session.read(Touch, 0)))
    assert touch.time[-1] - touch.time[0] > 2 * s
    ends = [each["end"] for each in done.session.frame("episodes").to_dicts()]
    assert ends[-1] <= done.about["end_ns"]


def test_a_lost_sensor_stops_the_arm(tmp_path: Path) -> None:
    interrupted(made(tmp_path / "data", act=unplug), "has given no sample for 1 s")


def test_ctrl_c_stops_the_arm_and_commits_during_a_pause(tmp_path: Path) -> None:
    def pause(_: VirtualLab) -> None:
        signal.raise_signal(signal.SIGUSR1)
        asyncio.get_running_loop().call_later(1.0, signal.raise_signal, signal.SIGINT)

    done = made(tmp_path / "data", act=pause)
    interrupted(done, "interrupted")
    assert done.collected.interrupted


def test_a_stroke_in_the_air_ends_the_collection(tmp_path: Path) -> None:
    done = made(tmp_path / "data", pressed=False, place=(*PLACE[:2], 0.003, *PLACE[3:]))
    assert "fingertip 0 measured no contact in a stroke" in done.collected.error
    assert "fingertip 0 measured no contact in a stroke" in done.about["error"]
    assert not done.about["complete"]
    assert len(done.session.frame("episodes")) == 2  # the air, and one stroke


def test_nothing_moves_without_a_sensor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flows.lab.collection.collector.FIRST_SAMPLE", 0.5)
    with pytest.raises(EndpointError, match=VIRTUAL):
        made(tmp_path / "data", act=unplug, pressed=False)
    assert not list(tmp_path.iterdir())


def test_operators_are_compiled_before_the_arm_is_commanded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = list[str]()

    class Arm(UrArm):
        async def __aenter__(self) -> Self:
            steps.append("commanded")
            raise EndpointError("the arm", "is not needed here")

    def compiled(flow: Flow) -> CompiledFlow:
        steps.append("compiled")
        return CompiledFlow(flow)

    monkeypatch.setattr("flows.lab.collection.collector.UrArm", Arm)
    monkeypatch.setattr("flows.lab.collection.collector.CompiledFlow", compiled)
    with pytest.raises(EndpointError, match="is not needed here"):
        made(tmp_path / "data", pressed=False)
    assert steps == ["compiled", "commanded"]


def test_a_path_outside_the_workspace_is_refused() -> None:
    series = QUICK.series(PLACE, seed=0)
    with pytest.raises(ParameterError, match=r"from -0\.0200 to 0\.0200 m along x"):
        workspace(series, None, Limits(workspace=(-0.01, -1.0, -1.0, 0.01, 1.0, 1.0)))
    with pytest.raises(ParameterError, match="along z"):  # where the arm is now counts
        workspace(series, (0, 0, 0.5, math.pi, 0, 0), Limits(workspace=(-0.1, -0.1, -0.1, 0.1, 0.1, 0.1)))
    low, high = workspace(series, None, Limits(margin=0.01))
    np.testing.assert_allclose((low, high), ((-0.03, -0.03, -0.0115), (0.03, 0.03, 0.014)), atol=1e-9)


def test_a_failed_watch_for_samples_stops_the_arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def fail(*_: object) -> None:
        await asyncio.sleep(3.0)
        raise KeyError("planted")

    monkeypatch.setattr(Collector, "_watch", fail)
    interrupted(made(tmp_path / "data"), "the watch for samples has failed: KeyError: 'planted'")
