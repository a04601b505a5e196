import pytest

from connectors.sim.moved import Moved
from connectors.sim.scene import Move


@pytest.fixture
def moved() -> Moved:
    made = Moved("sphere")
    for number in range(4):
        made.add(Move("tap", 1.0, direction_deg=45.0 * number, speed=0.05), 10 * number, 10 * number + 10)
    return made


def test_a_move_is_told_of_as_an_episode(moved: Moved) -> None:
    assert moved[-1] == {
        "start": 30,
        "end": 40,
        "motion": "tap",
        "axis": "oblique",
        "direction_deg": 135.0,
        "speed": 0.05,
        "curvature": "sphere",
    }


def test_it_is_sliced_as_a_list_is(moved: Moved) -> None:
    whole = [*moved]
    for part in (slice(2, None), slice(-1, None), slice(None), slice(9, None), slice(None, None, -1)):
        assert moved[part] == whole[part]
    with pytest.raises(IndexError):
        moved[4]


def test_what_was_sliced_stays_when_a_run_begins_anew(moved: Moved) -> None:
    before = moved[1:]
    moved.clear()
    assert (len(moved), len(before), moved[:]) == (0, 3, [])
    moved.add(Move("hold", 1.0), 0, 1)
    assert [each["motion"] for each in (moved[0],)] == ["hold"]
