import pickle
from dataclasses import replace
from math import nan
from threading import Thread
from typing import Any, cast

import numpy as np
import pytest

from connectors.sim.arm_motion import in_base
from connectors.sim.commanded_motion import CommandedArm
from connectors.sim.finger import Finger
from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import Faults, Scene, commanded_scene
from connectors.sim.truth import true_slips
from operators.batch import Commands, concat, ms, s
from operators.errors import ParameterError
from tests.connectors.emulators.observed_scene import ObservedScene

START = 1_700_000_000 * s
LEAVE = [nan] * 6


def lab(scene: Scene | None = None, fingers: tuple[int, ...] = (0,)) -> ObservedScene:
    return ObservedScene(scene, 3, fingers=fingers, now=lambda: START)


def command(time: int, force: float, velocity: list[float]) -> Commands:
    return Commands(np.array([START + time]), np.array([force]), np.array([velocity])).check()


def stroke() -> Commands:
    """Press with 2 N, then drag."""
    drag = command(500 * ms, nan, [0.05, 0.07, 0.0, 0.0, 0.0, 0.5])
    return concat(Commands, [command(100 * ms, 2.0, LEAVE), drag])


def test_a_fingertip_and_the_motion_are_those_of_the_commanded_arm() -> None:
    scene, arm = lab(), CommandedArm(commanded_scene(), START)
    scene.command(stroke())
    arm.add(stroke())
    seen = [(*scene.touch(0, START + k * 10 * ms), *scene.motion(START + k * 10 * ms)) for k in range(140)]
    counts, temperature, pose, velocity = (np.array(column) for column in zip(*seen, strict=True))
    taken = Finger(commanded_scene(), 3, arm=arm).take(140)
    assert taken is not None
    np.testing.assert_array_equal(counts, taken[0].counts)
    np.testing.assert_array_equal(temperature, taken[0].temperature)
    np.testing.assert_array_equal(scene.truth().sliding, taken[1].sliding)
    np.testing.assert_array_equal(scene.truth().time, START + taken[1].time)
    arm = CommandedArm(commanded_scene(), START)
    arm.add(stroke())
    expected = in_base(*arm.at(np.arange(0, 1.4, 0.01)))
    np.testing.assert_allclose(velocity, expected[0], atol=1e-12)
    np.testing.assert_allclose(pose, expected[1], atol=1e-12)


def test_the_default_scene_stands_still_in_the_air_and_its_cells_are_noisy() -> None:
    scene = lab()
    counts = np.array([scene.touch(0, START + k * 10 * ms)[0] for k in range(200)])
    assert counts.std(axis=0) == pytest.approx(np.sqrt(0.6**2 + 1 / 12), rel=0.2)
    assert not scene.truth().force.any()
    assert not scene.motion(START + s)[1].any()


def test_an_instant_of_the_past_gives_the_newest_reading() -> None:
    scene = lab()
    scene.command(stroke())
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
    scene = lab(replace(commanded_scene(), faults=Faults(dead=(4,))))
    counts, temperature = scene.touch(0, START + 300 * ms)
    assert np.flatnonzero(counts == 0).tolist() == np.flatnonzero(temperature == 0).tolist() == [4]
    assert counts.dtype == temperature.dtype == np.dtype(np.int16)


def test_after_a_long_silence_the_scene_is_where_it_would_be_anyway() -> None:
    quiet = replace(commanded_scene(), parameters=Parameters())
    asked, silent = lab(quiet), lab(quiet)
    for scene in (asked, silent):
        scene.command(stroke())
    for k in range(140):
        asked.touch(0, START + k * 10 * ms)
    silent.advance(START + 1000 * ms)
    silent.advance(START + 900 * ms)
    difference = silent.touch(0, START + 1390 * ms)[0] - asked.touch(0, START + 1390 * ms)[0]
    assert np.abs(difference).max() <= 12  # the creep is followed in longer steps
    assert silent.truth().force[-1] == asked.truth().force[-1]


def test_threads_may_ask_and_command_at_once() -> None:
    scene, failed = lab(fingers=(0, 1)), list[BaseException]()

    def ask(finger: int) -> None:
        try:
            for k in range(100):
                scene.touch(finger, START + k * 10 * ms)
                scene.motion(START + k * 10 * ms)
                scene.command(command(k * 10 * ms, 1.0 + k % 3, LEAVE))
        except BaseException as error:  # noqa: BLE001 - raised again in the main thread
            failed.append(error)

    threads = [Thread(target=ask, args=[k % 2]) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    for finger in (0, 1):
        assert (np.diff(scene.truth(finger).time) > 0).all()


def test_commands_that_all_devices_have_passed_are_forgotten() -> None:
    scene, sizes = lab(fingers=(0, 1)), list[int]()
    for k in range(300):
        time = k * 10 * ms
        scene.command(command(time, nan, [0.001 * k, 0.0, 0.0, 0.0, 0.0, 0.0]))
        scene.motion(START + time)
        scene.touch(0, START + time)
        scene.touch(1, START + time)
        sizes.append(len(pickle.dumps(cast("Any", scene)._arm)))
    assert max(sizes) < 2 * sizes[5]
    assert scene.motion(START + 3 * s)[1][0] == pytest.approx(0.299)


def test_a_lab_without_fingertips_is_refused() -> None:
    with pytest.raises(ParameterError, match="fingers"):
        lab(fingers=())
