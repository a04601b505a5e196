from dataclasses import replace

import numpy as np
import pytest

from connectors.emulators.gripper_mechanism import FASTEST, SLOWEST, Mechanism, encode_status
from connectors.gripper.grip_force import ForceScale
from connectors.gripper.robotiq import Fingers, Phase, Request
from operators.batch import Commands, ms, s

START = 1_000 * s
CLOSE = Request(active=True, go=True, position=255, speed=255, force=255)
MET = 102  # of 255: 0.4 of the way


class Scene:
    """Remembers with what force it was gripped, and since when."""

    def __init__(self) -> None:
        self.commanded = list[tuple[int, float]]()  # ns since the start, N

    def command(self, commands: Commands) -> None:
        assert np.isnan(commands.check().velocity).all()
        [time], [force] = commands.time.tolist(), commands.force.tolist()
        self.commanded.append((time - START, force))


def active(scene: Scene, contact: int | None = MET) -> tuple[Mechanism, int]:
    """A gripper that has been activated, and when it was."""
    mechanism = Mechanism(scene, START, contact=contact)
    mechanism.request(Request(active=True), START)
    now = START + 2 * s + 10 * ms
    assert mechanism.status(now).ready
    return mechanism, now


def test_it_begins_with_registers_of_zeros() -> None:
    assert encode_status(Mechanism(Scene(), START).status(START + 5 * s)) == bytes(16)


def test_an_activation_takes_its_time_and_shows_as_the_manual_says() -> None:
    mechanism = Mechanism(Scene(), START)
    mechanism.request(Request(active=True), START)
    shown = [encode_status(mechanism.status(START + at * ms))[:2].hex() for at in (9, 10, 2009, 2010)]
    assert shown == ["0000", "1100", "1100", "3100"]


def test_the_fingers_stop_at_the_object_and_grip_it_from_that_instant_on() -> None:
    scene = Scene()
    mechanism, now = active(scene)
    mechanism.request(CLOSE, now)
    begun = now + 10 * ms
    way = round(FASTEST * 0.4 * s)
    mechanism.status(begun + way // 2)
    moving = mechanism.status(begun + way // 2)
    assert (moving.fingers, moving.positions, moving.echo) == (Fingers.MOVING, (51, 51, 51), 255)
    assert not moving.object_detected
    assert not scene.commanded
    held = mechanism.status(begun + 3 * way)  # no status request in between
    assert (held.fingers, held.positions) == (Fingers.ALL_STOPPED, (102, 102, 102))
    assert held.object_detected
    assert encode_status(held)[:4].hex() == "b9ea00ff"  # as in the manual's example
    [(instant, force)] = scene.commanded
    assert abs(instant - (begun + way - START)) <= 1
    assert force == 60.0


def test_without_an_object_they_reach_where_they_are_to_go() -> None:
    scene = Scene()
    mechanism, now = active(scene, contact=None)
    mechanism.request(replace(CLOSE, position=200), now)
    status = mechanism.status(now + 10 * s)
    assert (status.fingers, status.positions, status.object_detected) == (Fingers.ARRIVED, (200,) * 3, False)
    assert not scene.commanded


def test_an_object_beyond_the_requested_position_is_not_touched() -> None:
    scene = Scene()
    mechanism, now = active(scene)
    mechanism.request(replace(CLOSE, position=MET), now)
    assert mechanism.status(now + 10 * s).fingers is Fingers.ARRIVED
    assert not scene.commanded


def test_more_force_grips_harder_less_does_not_loosen_and_opening_lets_go() -> None:
    scene, scale = Scene(), ForceScale()
    mechanism, now = active(scene)
    for step, force in enumerate((40, 200, 90)):
        mechanism.request(replace(CLOSE, force=force), now + 5 * step * s)
        mechanism.advance(now + 5 * (step + 1) * s)
    assert [force for _, force in scene.commanded] == [scale.force(40), scale.force(200)]
    assert scene.commanded[1][0] == now + 5 * s + 10 * ms - START
    mechanism.request(replace(CLOSE, position=0), now + 20 * s)
    mechanism.advance(now + 30 * s)
    assert scene.commanded[2:] == [(now + 20 * s + 10 * ms - START, 0.0)]
    assert mechanism.force == 0.0
    mechanism.request(replace(CLOSE, force=90), now + 30 * s)
    mechanism.advance(now + 40 * s)
    assert mechanism.force == scale.force(90)


def test_they_stay_where_they_are_when_they_are_not_to_go() -> None:
    mechanism, now = active(Scene(), contact=None)
    mechanism.request(replace(CLOSE, speed=0), now)
    half = now + 10 * ms + round(SLOWEST / 2 * s)
    mechanism.request(replace(CLOSE, go=False), half - 10 * ms)
    status = mechanism.status(half + 60 * s)
    assert (status.go, status.positions) == (False, (128,) * 3)


def test_a_request_during_the_activation_is_executed_after_it() -> None:
    mechanism = Mechanism(Scene(), START, contact=None)
    mechanism.request(CLOSE, START)
    activating, ready = mechanism.status(START + s), mechanism.status(START + 3 * s)
    assert [(each.phase, each.fault) for each in (activating, ready)] == [
        (Phase.ACTIVATING, 5),
        (Phase.READY, 0),
    ]
    assert mechanism.status(START + 10 * s).fingers is Fingers.ARRIVED


def test_it_does_not_act_before_it_is_activated() -> None:
    mechanism = Mechanism(Scene(), START)
    mechanism.request(replace(CLOSE, active=False), START)
    status = mechanism.status(START + 10 * s)
    assert (status.active, status.fault, status.positions) == (False, 7, (0, 0, 0))


def test_switched_off_and_on_its_registers_are_zeros_and_what_it_holds_falls_when_it_is_activated() -> None:
    scene = Scene()
    mechanism, now = active(scene)
    mechanism.request(CLOSE, now)
    mechanism.advance(now + 5 * s)
    mechanism.power_up()
    assert encode_status(mechanism.status(now + 6 * s)) == bytes(16)
    assert mechanism.force == 60.0
    mechanism.request(Request(active=True), now + 7 * s)
    assert mechanism.status(now + 10 * s).positions == (0, 0, 0)
    assert scene.commanded[-1] == (now + 7 * s + 10 * ms - START, 0.0)


@pytest.mark.parametrize("steps", [1, 7, 1000])
def test_how_often_it_is_looked_at_changes_nothing(steps: int) -> None:
    scene = Scene()
    mechanism, now = active(scene)
    mechanism.request(CLOSE, now)
    for step in range(steps):
        mechanism.advance(now + round((step + 1) / steps * 5 * s))
    [(instant, force)] = scene.commanded
    assert abs(instant - (now + 10 * ms + round(FASTEST * 0.4 * s) - START)) <= steps
    assert force == 60.0
    assert mechanism.status(now + 5 * s).positions == (102, 102, 102)
