import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
import pytest

from connectors.ur.ur_state import ArmState, Point, Pose
from flows.graph.testing import run_virtually
from flows.lab.collection.arm_path import Extent, Slide, Trace
from flows.lab.collection.contact_monitor import ContactMonitor
from flows.lab.collection.stroke_driver import StrokeDriver
from flows.lab.collection.stroke_plan import CollectionPlan, Press, StrokeSeries
from flows.lab.collection.surfaces import Surface
from flows.run.clocks import LoopClock
from operators import EndpointError, Episodes, s
from operators.batch import MOTIONS, SURFACES, columns

PLACE: Pose = (0.4, 0.0, 0.1, math.pi, 0.0, 0.0)
REST: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass
class TestArm:
    """Arm that reaches each target after the planned time."""

    __test__ = False
    state: ArmState = field(default_factory=lambda: ArmState(PLACE, REST))
    ways: list[Pose] = field(default_factory=list[Pose])
    stops: int = 0
    fault: str = ""
    surface: float = 0.002  # m below the start of a search
    tared: list[float] = field(default_factory=list[float])  # m, heights

    async def line(self, pose: Pose, speed: float, acceleration: float, seconds: float) -> None:
        await self.wait(seconds)
        self.state = ArmState(pose, REST)
        self.ways.append(pose)

    async def slide(self, velocity: Pose, seconds: float, acceleration: float) -> None:
        slide = Slide(velocity, seconds, acceleration)
        here = self.state.pose
        await self.wait(slide.seconds(here))
        self.state = ArmState(slide.end(here), REST)
        self.ways.append(slide.end(here))

    async def trace(self, points: Sequence[Point], speed: float, acceleration: float, seconds: float) -> None:
        await self.wait(seconds)
        self.state = ArmState((*points[-1], *self.state.pose[3:]), REST)
        self.ways += [(*point, *self.state.pose[3:]) for point in points]

    async def tare(self, seconds: float) -> None:
        await self.wait(seconds)
        self.tared.append(self.state.pose[2])

    async def touch(self, path: Point, force: float, speed: float, acceleration: float) -> float:
        part = self.surface / math.hypot(*path)  # of the path, until contact
        await self.wait(part * math.hypot(*path) / speed)
        x, y, z, a, b, c = self.state.pose
        self.state = ArmState((x + part * path[0], y + part * path[1], z + part * path[2], a, b, c), REST)
        return 1.1 * force

    async def wait(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
        if self.fault:
            raise EndpointError("arm", self.fault)

    async def stop(self) -> None:
        self.stops += 1

    def fail(self, reason: str) -> None:
        self.fault = reason

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        pass


def row(episode: Episodes) -> dict[str, Any]:
    """Return an episode's values by column, codes as names; `time` as `start`."""
    values = {name: getattr(episode, name).item() for name in columns(Episodes)}
    names: dict[str, Any] = {"motion": MOTIONS[values["motion"]], "surface": SURFACES[values["surface"]]}
    return {"start": values.pop("time"), **values, **names}


class TestMonitor(ContactMonitor):
    """Monitor with a given result."""

    __test__ = False

    def __init__(self, without_contact: list[int]) -> None:
        super().__init__()
        self._without_contact = without_contact

    def without_contact(self) -> list[int]:
        return self._without_contact


def session(strokes: int = 2, *, rotations: bool = False, force: float | None = None) -> StrokeSeries:
    plan = CollectionPlan(
        speeds=() if rotations else (0.1,),
        repeats=1,
        rotations=int(rotations),
        rounds=1,
        surfaces=(Surface("sphere"),),
        press=Press(force=force),
    )
    (whole,) = plan.series(PLACE)
    return replace(whole, strokes=whole.strokes[:strokes])


@dataclass
class Driven:
    arm: TestArm
    driver: StrokeDriver
    episodes: list[dict[str, Any]]
    seconds: float


def drive(
    planned: StrokeSeries,
    *acts: tuple[float, str],
    fault: str = "",
    without_contact: Sequence[int] = (),
    require_contact: bool = True,
) -> Driven:
    """Drive a series; call methods of the driver, or set a fault of the arm, at the given seconds."""

    async def main() -> Driven:
        clock, arm, episodes = LoopClock(0), TestArm(), list[Episodes]()

        async def take() -> None:
            async for episode in driver.batches(clock):
                episodes.append(episode)

        driver = StrokeDriver(arm, clock, require_contact=require_contact)
        taking = asyncio.create_task(take())
        await driver.follow([planned.begin])
        loop, began = asyncio.get_running_loop(), clock.now()
        for after, act in acts:
            loop.call_later(after, getattr(driver, act) if act else lambda: setattr(arm, "fault", fault))
        try:
            await driver.make_strokes(planned, TestMonitor([*without_contact]))
        except EndpointError as error:
            assert fault in error.reason  # noqa: PT017 - it may also go well
            assert fault
        await asyncio.sleep(0)  # the last episode is taken
        taking.cancel()
        return Driven(arm, driver, [row(each) for each in episodes], (clock.now() - began) / s)

    return run_virtually(main())


def test_each_contact_is_an_episode() -> None:
    planned = session(3)
    air, *strokes = drive(planned).episodes
    assert (air["motion"], (air["end"] - air["start"]) / s) == ("hold", pytest.approx(1.5))
    for stroke, episode in zip(planned.strokes, strokes, strict=True):
        values = {key: episode[key] for key in episode if key not in ("start", "end", "force")}
        assert values == {
            "motion": "translation",
            "surface": "sphere",
            "direction": stroke.direction,
            "speed": 0.1,
            "angular_speed": 0.0,
            "depth": 0.0015,
        }
        assert math.isnan(episode["force"])
        arc = 2 * 0.06 * math.asin(0.03 / 0.06)  # m, but for the chords
        seconds = 2 * 0.4 + arc / 0.1 + 0.1 / 0.5
        assert (episode["end"] - episode["start"]) / s == pytest.approx(seconds, abs=1e-3)
    assert all(a["end"] <= b["start"] for a, b in zip([air, *strokes], strokes, strict=False))


def test_a_paused_stroke_is_stopped_and_repeated_from_above() -> None:
    planned = session(2)
    driven = drive(planned, (3.5, "pause"), (60.0, "resume"))
    assert driven.arm.stops == 1
    assert driven.driver.strokes == 2
    assert 60 < driven.seconds < 60 + Extent.of(planned.steps, planned.begin.pose).seconds
    interrupted, again = driven.episodes[1:3]
    assert interrupted["direction"] == again["direction"]
    assert interrupted["end"] - interrupted["start"] < again["end"] - again["start"]
    assert again["start"] > 60 * s
    raised = driven.arm.ways[3]  # begin, over it, down, and after the pause
    np.testing.assert_allclose(raised[2], 0.11)


def test_a_pause_between_strokes_repeats_none() -> None:
    driven = drive(session(2), (0.1, "pause"), (60.0, "resume"))  # while it is in the air
    assert [each["motion"] for each in driven.episodes] == ["hold", "translation", "translation"]
    assert driven.seconds > 60


def test_a_stopped_arm_ends_the_series_and_its_episode() -> None:
    driven = drive(session(2), (3.5, ""), fault="emergency stop")
    assert driven.driver.strokes == 0
    assert driven.episodes[-1]["end"] <= driven.seconds * s + 1.5 * s


def test_a_stroke_without_contact_is_the_last() -> None:
    driven = drive(session(2), fault="fingertip 1 measured no contact in a stroke", without_contact=[1])
    assert [each["motion"] for each in driven.episodes] == ["hold", "translation"]
    assert "just touch the surface" in driven.arm.fault
    assert driven.arm.state.pose[2] == pytest.approx(0.11)  # in the air again


def test_a_stroke_with_a_force_keeps_the_depth_of_contact() -> None:
    planned = session(2, force=2.0)
    driven = drive(planned)
    assert driven.driver.strokes == 2
    traces = [step for stroke in planned.strokes for step in stroke.contact if isinstance(step, Trace)]
    ways = np.array([way[:3] for way in driven.arm.ways])  # (n, 3)
    first = 3  # of the stroke's ways, after those to begin, over it and near it
    for trace in traces:  # contact after 2 of 5 mm
        gone = ways[first : first + len(trace.points)]
        np.testing.assert_allclose(gone, np.add(trace.points, (0, 0, 0.003)), atol=1e-9)
        first += len(trace.points) + 3  # up, over the next, near it
    _, *strokes = driven.episodes
    assert [each["depth"] for each in strokes] == pytest.approx([0.001] * 2)  # 2 mm from 1 mm above it
    assert [each["force"] for each in strokes] == pytest.approx([2.2] * 2)
    assert driven.arm.tared == pytest.approx([0.11] * 2)  # in the air
    assert driven.arm.state.pose[2] == pytest.approx(0.11)
