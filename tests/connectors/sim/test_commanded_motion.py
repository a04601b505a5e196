from dataclasses import dataclass, field
from math import nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from connectors.sim.arm_motion import Arm, Controller
from connectors.sim.commanded_motion import CommandQueue
from connectors.sim.scene import Commanded, Move, Moves, Plan, Scene, Timing
from connectors.sim.simulated_rig import SimulatedRig
from connectors.sim.truth import true_slips
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource, run_virtually
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from operators import EVERY, Motion, Operator, Touch, Truth, ms, s
from operators.batch import Commands, Counts, Reals
from operators.errors import ParameterError

ORIGIN = 1_700_000_000 * s
LEAVE = [nan] * 6
DRAG = Moves((Move("hold", 0.5, force=1.0), Move("translation", 1.5, 0.3, 0.0, 0.1)))


def commands(*rows: tuple[float, float, list[float]]) -> Commands:
    """Time (s since the run began), force (N), velocity (m/s, rad/s) of each."""
    time, force, velocity = zip(*rows, strict=True)
    stamps = ORIGIN + np.round(np.array(time) * s).astype(np.int64)
    return Commands(stamps, np.array(force, float), np.array(velocity, float)).check()


@dataclass
class Tighten(Operator[Touch, Commands]):
    """Two newtons more whenever the counts jump: the least flow that closes the loop."""

    jump: float = 25.0  # counts
    force: float = 1.0  # N
    _last: Counts | None = field(default=None, init=False, repr=False)  # (6,)

    def process(self, batch: Touch) -> Commands:
        """A command for every jump."""
        times: list[int] = []
        forces: list[float] = []
        for time, counts in zip(batch.time.tolist(), batch.counts, strict=True):
            if self._last is not None and np.linalg.norm(counts - self._last) > self.jump:
                self.force = min(self.force + 2.0, 20.0)
                times.append(time)
                forces.append(self.force)
            self._last = counts
        leave = np.full((len(times), 6), nan)
        return Commands(np.array(times, np.int64), np.array(forces), leave, finger=batch.finger)


@dataclass
class Recorded:
    touch: Touch
    motion: Motion
    truth: Truth
    commands: Commands

    def bytes(self) -> bytes:
        arrays = (
            self.touch.time,
            self.touch.counts,
            self.motion.time,
            self.motion.velocity,
            self.motion.pose,
        )
        return b"".join(array.tobytes() for array in arrays)


def live(
    plan: Plan | Scene, given: Commands | None = None, *, loop: bool = False, seconds: float = 2.0
) -> Recorded:
    """What a live run in virtual time records; commands are given at their times, by hand or by a flow."""
    scene = plan if isinstance(plan, Scene) else Scene(plan, motion=Timing(125.0, latency=0.07))
    rig, flow = SimulatedRig(scene, seed=2), Flow("loop")
    touch, motion = flow.source(rig.touch), flow.source(rig.motion)
    seen, moved, happened, told = TestSink(), TestSink(), TestSink(), TestSink()
    flow.source(rig.truth).to(happened)
    touch.to(seen)
    motion.to(moved)
    if loop:
        ordered = touch | Tighten()
    else:
        rows = [] if given is None else [given[k : k + 1] for k in range(len(given))]
        start = Commands(np.array([ORIGIN]), np.array([nan]), np.array([LEAVE]))
        ordered = flow.source(TestSource(Commands, [start, *rows]))
    ordered.to(rig.hand)
    ordered.to(told)

    async def main() -> None:
        clock = LoopClock(ORIGIN)
        await LiveRunner(flow, "test", clock=clock, duration=round(seconds * s)).execute()

    run_virtually(main())
    finger = 0 if loop else EVERY
    return Recorded(
        seen.rows(Touch, 0), moved.rows(Motion), happened.rows(Truth, 0), told.rows(Commands, finger)
    )


def at(truth: Truth, column: Reals, second: float) -> Reals:
    row: Reals = column[np.searchsorted(truth.time, ORIGIN + round(second * s))]
    return row


def test_nothing_moves_until_it_is_told() -> None:
    recorded = live(Commanded(force=2.0))
    assert not recorded.motion.velocity.any()
    assert recorded.truth.force[-1] == pytest.approx(2.0)
    assert not true_slips(recorded.truth)


def test_a_commanded_force_is_approached_at_the_scenes_rate() -> None:
    scene = Scene(Commanded(force=2.0), force_rate=10.0)
    truth = live(scene, commands((0.5, 5.0, LEAVE), (1.5, 0.5, LEAVE))).truth
    found = [float(at(truth, truth.force, t)) for t in (0.5, 0.7, 0.8, 1.4, 1.6, 1.9)]
    assert found == pytest.approx([2.0, 4.0, 5.0, 5.0, 4.0, 1.0], abs=0.02)


def test_both_sources_see_a_commanded_velocity_from_its_time_on() -> None:
    recorded = live(Commanded(force=2.0), commands((0.5, nan, [0.06, 0.08, 0, 0, 0, 0])))
    truth, motion = recorded.truth, recorded.motion
    first = truth.time[np.argmax(truth.velocity.any(axis=1))]
    assert 0 < first - (ORIGIN + s // 2) <= 10 * ms
    began = motion.time[np.argmax(motion.velocity.any(axis=1))] - 70 * ms
    assert 0 < began - (ORIGIN + s // 2) <= 8 * ms
    assert motion.velocity[-1] == pytest.approx([0.06, 0.08, 0, 0, 0, 0])
    assert truth.velocity[-1] == pytest.approx([0.06, -0.08, 0])  # the fingertip looks down
    assert true_slips(truth)


def test_place_and_frame_stay_true_to_a_hand_that_translates_and_turns() -> None:
    velocity = [0.05, -0.02, 0.0, 0.0, 0.0, 0.8]
    recorded = live(Commanded(), commands((0.3, nan, velocity), (1.2, nan, [0.0] * 6)))
    motion = recorded.motion
    cruising = motion[(motion.time > ORIGIN + 500 * ms) & (motion.time < ORIGIN + 1200 * ms)]
    np.testing.assert_allclose(cruising.velocity, np.tile(velocity, (len(cruising), 1)), atol=1e-12)
    middle = (motion.velocity[1:] + motion.velocity[:-1]) / 2
    steps = np.diff(motion.pose[:, :3], axis=0)
    np.testing.assert_allclose(steps, middle[:, :3] * 0.008, atol=1e-5)  # ramps turn between two samples
    turned = Rotation.from_rotvec(motion.pose[-1, 3:]) * Rotation.from_rotvec(motion.pose[0, 3:]).inv()
    assert turned.as_rotvec() == pytest.approx([0, 0, 0.8 * 0.9])
    second = motion[motion.time == ORIGIN + 1070 * ms]  # one second after the start, reported 70 ms late
    seen = Rotation.from_rotvec(second.pose[0, 3:]).apply(second.velocity[0, :3], inverse=True)
    assert at(recorded.truth, recorded.truth.velocity, 1.0)[:2] == pytest.approx(seen[:2], abs=1e-4)


def test_a_plan_goes_on_in_what_is_not_commanded() -> None:
    plain, held = live(DRAG), live(DRAG, commands((0.9, 4.0, LEAVE)))
    np.testing.assert_array_equal(held.motion.velocity, plain.motion.velocity)
    assert held.truth.force[-1] == pytest.approx(4.0)
    stopped = live(DRAG, commands((1.2, nan, [0.0] * 6)))
    assert not stopped.motion.velocity[-1].any()
    np.testing.assert_allclose(stopped.truth.force, plain.truth.force, atol=1e-12)


def test_a_flow_that_grips_harder_when_the_counts_jump_shortens_the_slip() -> None:
    tug = Moves((Move("hold", 0.5, force=1.0), Move("translation", 0.5, 0.3, 0.0, 0.05), Move("hold", 1.0)))
    alone, closed = live(tug), live(tug, loop=True)
    assert closed.truth.force[-1] > alone.truth.force[-1] + 2
    slid = [float(recorded.truth.sliding.sum() * 0.01) for recorded in (alone, closed)]
    assert slid[1] < 0.6 * slid[0]


def test_the_same_commands_at_the_same_times_give_the_same_bytes() -> None:
    closed = live(DRAG, loop=True)
    assert closed.bytes() == live(DRAG, loop=True).bytes()
    told = Commands(closed.commands.time, closed.commands.force, closed.commands.velocity)
    assert closed.bytes() == live(DRAG, told).bytes()
    assert closed.bytes() != live(DRAG, told[1:]).bytes()


def test_a_command_that_comes_late_is_obeyed_by_both_sources_at_once() -> None:
    rig = SimulatedRig(Scene(Commanded(force=1.0)), pace=1.0)
    rig.commands.begin(ORIGIN)
    rig.commands.mark_simulated(1.0)
    rig.commands.add(commands((0.5, nan, [0.1, 0, 0, 0, 0, 0])))
    motion = Controller(rig.scene, 0, rig.commands).take(200)
    assert motion is not None
    moving = motion.time[motion.velocity.any(axis=1)]
    assert moving[0] == 70 * ms + 1008 * ms


@given(st.lists(st.integers(0, 2000), max_size=20).map(sorted), st.integers(0, 20))
def test_asking_piecewise_changes_nothing(ticks: list[int], cut: int) -> None:
    told = commands((0.1, 3.0, LEAVE), (0.1, nan, [0.1, 0, 0, 0, 0, 1]), (0.8, 0.0, [0.0] * 6))
    times = np.array(ticks) * 1e-3
    found: list[Reals] = []
    for parts in ([times], [times[:cut], times[cut:]]):
        queue = CommandQueue()
        queue.begin(ORIGIN)
        queue.add(told)
        arm = Arm(Scene(DRAG), 0, commands=queue)
        paths = [arm.at(part) for part in parts]
        found.append(np.hstack([np.concatenate([getattr(p, n) for p in paths]) for n in ("drive", "pose")]))
    np.testing.assert_array_equal(found[0], found[1])


def test_without_commands_the_hand_changes_no_byte() -> None:
    recorded = live(DRAG)
    controller = Controller(Scene(DRAG, motion=Timing(125.0, latency=0.07)), 2)
    expected = controller.take(len(recorded.motion))
    assert expected is not None
    np.testing.assert_array_equal(recorded.motion.velocity, expected.velocity)
    np.testing.assert_array_equal(recorded.motion.pose, expected.pose)


def test_a_hand_is_commanded_only_while_time_is_kept() -> None:
    rig, flow = SimulatedRig(pace=None), Flow("loop")
    (flow.source(rig.touch) | Tighten()).to(rig.hand)

    async def main() -> None:
        await LiveRunner(flow, "test").execute()

    with pytest.raises(ParameterError, match="pace"):
        run_virtually(main())
