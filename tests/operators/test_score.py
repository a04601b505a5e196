import re
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from operators import BatchError, ParameterError, Score, Zeroed, ms
from operators.batch import Counts, Reals
from operators.fingertip import TAKKTILE, Fingertip
from storage import load_detector


@dataclass
class _Keeper:
    """A detector that keeps what it is given and gives the newest count of the first cell, by 1000."""

    name: str = "keeper"
    length: int = 2
    given: list[Counts | Reals] = field(default_factory=list[Counts | Reals])

    def score(self, windows: Counts | Reals) -> Reals:
        self.given.append(windows)
        return windows[:, -1, 0] / 1000


def _touch(*first: int, rows: int = 0) -> Zeroed:
    counts = np.zeros((len(first) or rows, 6), np.int16)
    counts[:, 0] = first or np.arange(rows)
    return Zeroed(np.arange(len(counts)) * 10 * ms, counts, counts, np.ones_like(counts, np.bool_), finger=6)


@pytest.mark.parametrize(
    "detector",
    ["tcn", _Keeper, SimpleNamespace(length=2), SimpleNamespace(score=abs), _Keeper(length=cast("int", 2.0))],
    ids=["name", "class", "no score", "no length", "fraction"],
)
def test_what_is_no_detector_is_refused_with_what_to_write(detector: Any) -> None:
    must_be = r"must be an object with name, length \(whole samples\) and score: .* load_detector\('tcn'\)$"
    with pytest.raises(ParameterError, match=f"^Score: detector is .*, {must_be}"):
        Score(detector)


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (None, "returned NoneType, must return an array of floats of shape (2,)"),
        (0.5, "returned float, must return an array of floats"),
        ([0.5, 0.5], "returned list, must return an array of floats"),
        (np.array([0, 1]), "returned int64 of shape (2,), must return an array of floats"),
        (np.array([0.5]), "returned float64 of shape (1,), must return an array of floats of shape (2,)"),
        (np.full((2, 1), 0.5), "returned float64 of shape (2, 1), must return an array of floats of shape"),
        (np.array([0.5, 17.98]), "returned 17.98, must return numbers from 0 to 1, or NaN"),
        (np.array([np.nan, -0.1]), "returned -0.1, must return numbers from 0 to 1, or NaN"),
        (np.array([np.inf, 0.5]), "returned inf, must return numbers from 0 to 1, or NaN"),
    ],
)
def test_a_wrong_result_is_an_error_that_names_the_detector(returned: Any, message: str) -> None:
    class Wrong(_Keeper):
        def score(self, windows: Counts | Reals) -> Reals:
            return cast("Reals", returned)

    with pytest.raises(BatchError, match=re.escape(f"Scores.probability: Wrong.score {message}")):
        Score(Wrong()).push(_touch(rows=3))


def test_scores_may_be_unknown_and_of_any_precision() -> None:
    class Single(_Keeper):
        def score(self, windows: Counts | Reals) -> Reals:
            return cast("Reals", np.array([0.0, 1.0, np.nan], np.float32))

    scores = Score(Single()).push(_touch(rows=4)).check()
    assert str(scores.probability) == "[ 0.  1. nan]"


def test_a_detector_is_given_few_windows_at_once_and_the_scores_have_the_times_of_the_newest_samples() -> (
    None
):
    keeper = _Keeper()
    scores = Score(keeper).push(_touch(rows=200))
    assert max(map(len, keeper.given)) == 64
    np.testing.assert_array_equal(np.concatenate(keeper.given)[:, 0, 0], np.arange(199))
    np.testing.assert_array_equal(scores.probability, np.arange(1, 200) / 1000)
    np.testing.assert_array_equal(scores.time, np.arange(1, 200) * 10 * ms)
    assert scores.finger == 6


def test_an_invalid_reading_is_taken_to_be_the_last_valid_one_and_0_before_any() -> None:
    keeper, touch = _Keeper(), _touch(7, 8, 9, 10)
    touch.valid[[0, 2, 3], 0] = False
    score = Score(keeper)
    for row in range(4):
        score.push(touch[row : row + 1])
    assert [window[0, :, 0].tolist() for window in keeper.given] == [[0, 8], [8, 8], [8, 8]]


def test_the_number_of_cells_comes_from_the_batch() -> None:
    cells = np.full((3, 9), 200, np.int16)
    touch = Zeroed(np.arange(3), cells, cells, np.ones_like(cells, np.bool_))
    touch.valid[0] = touch.valid[1, :4] = touch.valid[2, :5] = False
    assert np.isnan(Score(_Keeper(length=1)).push(touch).probability).tolist() == [True, False, True]


@pytest.mark.parametrize("compiled", [True, False], ids=["windows", "without numba"])
def test_a_streaming_detector_judges_as_one_of_windows(
    monkeypatch: pytest.MonkeyPatch, *, compiled: bool
) -> None:
    rng, tcn = np.random.default_rng(0), load_detector("tcn")
    shape = tcn.length + 400, 6
    counts, valid = rng.integers(-500, 50, shape).astype(np.int16), rng.random(shape) > 0.4
    touch = Zeroed(np.arange(len(counts)), counts, counts, valid, finger=6)
    found = Score(tcn).push(touch)
    if not compiled:
        monkeypatch.setattr("operators.score.compiler", lambda: None)
    windowed: Any = SimpleNamespace(name="windowed", length=tcn.length, score=tcn.score)  # does not stream
    expected = Score(windowed if compiled else tcn).push(touch)
    np.testing.assert_allclose(found.probability, expected.probability, atol=1e-5)
    np.testing.assert_array_equal(found.time, expected.time)
    assert 0 < np.isnan(found.probability).sum() < len(found)


def test_a_detector_of_a_user_is_adapted_to_the_fingertip_too() -> None:
    class Adapted(_Keeper):
        def for_fingertip(self, given: Fingertip) -> _Keeper:
            return _Keeper(f"keeper of {given.cells} cells")

    assert Score(Adapted()).for_fingertip(TAKKTILE).detector.name == "keeper of 6 cells"
