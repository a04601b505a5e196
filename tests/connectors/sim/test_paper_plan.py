from itertools import pairwise

import pytest

from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import Move, PaperStrokes, Scene


def moves(scene: Scene, seed: int = 0) -> list[Move]:
    return [move for _, move in scene.moves(seed)]


def test_the_plan_rests_as_often_as_the_papers_and_lasts_hardly_longer() -> None:
    """The paper has 143,584 static and 122,918 slip samples at 100 Hz."""
    every = [move for n, scene in enumerate(PaperPlan().scenes(0)) for move in moves(scene, n)]
    seconds = sum(move.seconds for move in every)
    moving = sum(move.seconds - move.rest for move in every if move.speed)
    assert 2665 <= seconds < 1.15 * 2665
    assert moving / seconds == pytest.approx(0.46, abs=0.012)


def test_a_recording_strokes_in_every_direction_once_a_round() -> None:
    strokes = [move.direction_deg for move in moves(Scene(PaperStrokes(0.1))) if move.speed]
    assert sorted(strokes[:8]) == sorted(strokes[8:]) == [45.0 * n for n in range(8)]


def test_a_lifted_finger_comes_down_again() -> None:
    followed = [
        (a.motion, b.force)
        for n in range(20)
        for a, b in pairwise(moves(Scene(PaperStrokes(disturbed=True)), n))
    ]
    after = [force for motion, force in followed if motion == "lift"]
    assert len(after) > 3
    assert all(force is not None and force > 0 for force in after)
