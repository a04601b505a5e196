from math import nan
from threading import Thread

import numpy as np
import pytest

from connectors.sim.arm_motion import Controller
from connectors.sim.finger import Finger
from connectors.sim.scene import Faults, Move, Moves, Scene, Timing
from connectors.sim.truth import true_slips
from operators.batch import Commands, ms, s
from operators.errors import ParameterError
from tests.connectors.emulators.observed_scene import ObservedScene

START = 1_700_000_000 * s
LEAVE = [nan] * 6
STROKE = Moves((Move("hold", 0.5, force=2.0), Move("translation", 1.0, 0.2, 45.0, 0.1)))


def lab(scene: Scene | None = None, fingers: tuple[int, ...] = (0,)) -> ObservedScene:
    return ObservedScene(scene, 3, fingers=fingers, now=lambda: START)


def command(time: int, force: float, velocity: list[float]) -> Commands:
    return Commands(np.array([START + time]), np.array([force]), np.array([velocity])).check()


def test_a_fingertip_that_is_asked_every_10_ms_feels_what_a_sampled_one_feels() -> None:
    taken = Finger(Scene(), 3).take(300)
    assert taken is not None
    scene = lab(Scene())
    asked = [scene.touch(0, START + k * 10 * ms) for k in range(300)]
    np.testing.assert_array_equal([counts for counts, _ in asked], taken[0].counts)
    np.testing.assert_array_equal([temperature for _, temperature in asked], taken[0].temperature)
    np.testing.assert_array_equal(scene.truth().sliding, taken[1].sliding)
    np.testing.assert_array_equal(scene.truth().time, START + taken[1].time)


def test_the_motion_is_what_a_controller_without_delay_reports() -> None:
    reported = Controller(Scene(STROKE, motion=Timing(125.0)), 3).take(180)
    assert reported is not None
    scene = lab(Scene(STROKE))
    seen = [scene.motion(START + k * 8 * ms) for k in range(180)]
    np.testing.assert_allclose([pose for pose, _ in seen], reported.pose, atol=1e-12)
    np.testing.assert_allclose([velocity for _, velocity in seen], reported.velocity, atol=1e-12)


def test_the_default_scene_stands_still_in_the_air_and_its_cells_are_noisy() -> None:
    scene = lab()
    counts = np.array([scene.touch(0, START + k * 10 * ms)[0] for k in range(200)])
    assert counts.std(axis=0) == pytest.approx(np.sqrt(0.6**2 + 1 / 12), rel=0.2)
    assert not scene.truth().force.any()
    assert not scene.motion(START + s)[1].any()


def test_an_instant_of_the_past_gives_the_newest_reading() -> None:
    scene = lab(Scene(STROKE))
    newest, seen = scene.touch(0, START + 700 * ms)[0], scene.motion(START + 900 * ms)
    assert seen[1].any()
    for earlier in (START - s, START, START + 700 * ms):
        np.testing.assert_array_equal(scene.touch(0, earlier)[0], newest)
        np.testing.assert_array_equal(scene.motion(earlier), seen)


def test_the_arm_that_is_commanded_drags_the_fingertip() -> None:
    scene = lab()
    scene.command(command(100 * ms, 2.0, LEAVE))
    scene.command(command(500 * ms, nan, [0.0, 0.1, 0.0, 0.0, 0.0, 0.0]))
    scene.command(command(900 * ms, nan, [0.0] * 6))
    counts = np.array([scene.touch(0, START + k * 10 * ms)[0] for k in range(120)])
    poses, velocities = zip(*(scene.motion(START + k * 10 * ms) for k in range(120)), strict=True)
    truth = scene.truth()
    assert (counts[40:45].mean(axis=0) < counts[:10].mean(axis=0) - 20).all()
    assert len(true_slips(truth)) == 1
    assert START + 500 * ms < true_slips(truth)[0][0] < START + 700 * ms
    assert velocities[80] == pytest.approx([0.0, 0.1, 0.0, 0.0, 0.0, 0.0], abs=1e-9)
    assert poses[-1][1] == pytest.approx(0.04)
    assert not velocities[-1].any()
    assert truth.velocity[80, 1] == pytest.approx(-0.1)  # the fingertip looks down


def test_fingertips_feel_one_motion_with_cells_of_their_own() -> None:
    scene = lab(fingers=(0, 4))
    scene.command(command(0, 2.0, LEAVE))
    counts = [scene.touch(finger, START + 400 * ms)[0] for finger in (0, 4)]
    assert counts[0].tolist() != counts[1].tolist()
    assert scene.truth(0).force[-1] == scene.truth(4).force[-1] == pytest.approx(2.0)


def test_a_cell_that_the_scene_declares_dead_converts_to_0() -> None:
    counts, temperature = lab(Scene(STROKE, faults=Faults(dead=(4,)))).touch(0, START + 300 * ms)
    assert np.flatnonzero(counts == 0).tolist() == np.flatnonzero(temperature == 0).tolist() == [4]
    assert counts.dtype == temperature.dtype == np.dtype(np.int16)


def test_after_a_long_silence_the_scene_is_where_it_would_be_anyway() -> None:
    asked, silent = lab(Scene(STROKE)), lab(Scene(STROKE))
    for k in range(140):
        asked.touch(0, START + k * 10 * ms)
    silent.advance(START + 1000 * ms)
    silent.advance(START + 900 * ms)
    difference = silent.touch(0, START + 1390 * ms)[0] - asked.touch(0, START + 1390 * ms)[0]
    assert np.abs(difference).max() <= 12  # the creep is followed in longer steps
    assert silent.truth().force[-1] == asked.truth().force[-1]


def test_a_plan_that_has_ended_leaves_the_scene_as_it_is() -> None:
    scene = lab(Scene(STROKE))
    last, pose = scene.touch(0, START + 1490 * ms)[0], scene.motion(START + 1490 * ms)[0]
    for k in range(3):
        np.testing.assert_array_equal(scene.touch(0, START + (2 + k) * s)[0], last)
    at, velocity = scene.motion(START + 9 * s)
    np.testing.assert_array_equal(at, pose)
    assert not velocity.any()


def test_threads_may_ask_and_command_at_once() -> None:
    scene, failed = lab(fingers=(0, 1)), list[BaseException]()

    def ask(finger: int) -> None:
        try:
            for k in range(100):
                scene.touch(finger, START + k * 10 * ms)
                scene.motion(START + k * 10 * ms)
                scene.command(command(k * 10 * ms, 1.0 + k % 3, LEAVE))
        except BaseException as error:  # noqa: BLE001 - told by the main thread
            failed.append(error)

    threads = [Thread(target=ask, args=[k % 2]) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    for finger in (0, 1):
        assert (np.diff(scene.truth(finger).time) > 0).all()


def test_commands_that_all_have_obeyed_are_forgotten() -> None:
    scene = lab(fingers=(0, 1))
    for k in range(300):
        time = k * 10 * ms
        scene.command(command(time, nan, [0.001 * k, 0.0, 0.0, 0.0, 0.0, 0.0]))
        scene.motion(START + time)
        scene.touch(0, START + time)
        scene.touch(1, START + time)
    assert len(scene.commands.setpoints) < 5
    assert scene.motion(START + 3 * s)[1][0] == pytest.approx(0.299)


def test_a_lab_without_fingertips_is_refused() -> None:
    with pytest.raises(ParameterError, match="fingers"):
        lab(fingers=())
