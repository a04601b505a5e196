import numpy as np
import pytest

from flows.learn.evaluation.motion_metrics import Cell, Cells
from flows.learn.labelled_recordings import LabelledRecording

SLIDE = Cell("primary", 0.05, "plane")
ACROSS = Cell("oblique", 0.05, "plane")
TURN = Cell("rotation", None, "sphere")


def recording(surface: str, speed: float | None, oblique: list[bool] | None) -> LabelledRecording:
    label = np.array([0, 1] * 5, np.int8)
    known = None if oblique is None else np.array(oblique)
    return LabelledRecording(np.zeros((10, 6), np.int16), label, surface, speed, known)


@pytest.fixture
def cells() -> Cells:
    recordings = [
        recording("plane", 0.05, [False] * 6 + [True] * 4),
        recording("sphere", None, [False] * 10),
        recording("", None, None),
    ]
    at = [np.arange(2, 10)] * 3
    slip = [one.slip[2:] for one in recordings]
    return Cells.of(recordings, at, [slip[0], ~slip[1], slip[2]])


def test_answers_are_counted_by_axis_speed_and_surface(cells: Cells) -> None:
    assert cells.at(SLIDE).counts.tolist() == [[2, 0], [0, 2]]
    assert cells.at(ACROSS).f1 == 100
    assert cells.at(TURN).accuracy == 0
    assert np.isnan(cells.at(Cell("oblique", 0.1, "plane")).f1)


def test_a_recording_whose_strokes_are_not_known_is_left_out(cells: Cells) -> None:
    assert {cell.surface for cell in cells.cells} == {"plane", "sphere"}
    assert cells.confusion().counts.sum() == 16


def test_a_gap_has_the_sign_of_the_better_group(cells: Cells) -> None:
    gap, _ = cells.gap(lambda cell: cell.surface == "plane", lambda cell: cell == TURN)
    assert gap == 100
    assert np.isnan(cells.gap(lambda cell: cell == TURN, lambda cell: cell.surface == "cylinder_x")).all()
