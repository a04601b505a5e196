from math import nan

import pytest

from connectors.ur.contact_search import AVERAGED, OVERRUN, ContactSearch, mean_force
from connectors.ur.ur_state import ArmState
from operators import ParameterError

REST = (0.0,) * 6
AIR = (1.0, -2.0, 5.0)  # N, reported in the air


def at(z: float, push: float = 0.0) -> ArmState:
    """Return the state of an arm at a height (m), pushed up (N) in addition to the force in the air."""
    return ArmState((0.0, 0.0, z, 0.0, 0.0, 0.0), REST, (AIR[0], AIR[1], AIR[2] + push))


def search() -> ContactSearch:
    return ContactSearch(at(0.0), (0.0, 0.0, -0.004), 2.0, AIR)


def test_moving_on_past_the_end_of_the_path_is_an_overrun() -> None:
    down = search()
    assert not down.overrun(at(-0.004 - 0.9 * OVERRUN))
    assert down.overrun(at(-0.0052)) == "it moved 1.2 mm past the end of its 4.0 mm contact search"


def test_contact_is_found_by_the_mean_of_the_newest_states() -> None:
    down = search()
    assert not any(down.update(at(-0.001, 2.1)) for _ in range(AVERAGED - 1))
    assert down.update(at(-0.001, 2.1))
    assert down.found


def test_a_single_outlier_is_no_contact() -> None:
    down = search()
    for push in (0.0, 0.0, 7.0, 0.0, 0.0):
        assert not down.update(at(-0.001, push))


def test_a_push_along_the_motion_or_from_the_side_is_no_contact() -> None:
    down = search()
    for _ in range(10):
        assert not down.update(at(-0.001, -9.0))
        assert not down.update(ArmState((0, 0, -0.001, 0, 0, 0), REST, (9.0, 9.0, 5.0)))


def test_an_unknown_force_is_no_contact() -> None:
    assert mean_force([at(0.0), ArmState(at(0.0).pose, REST)]) is None
    assert mean_force([at(0.0), at(0.0, 1.0)]) == pytest.approx((1.0, -2.0, 5.5))
    down = ContactSearch(at(0.0), (0.0, 0.0, -0.004), 2.0, (nan, nan, nan))
    assert not any(down.update(at(-0.001, 9.0)) for _ in range(10))


def test_an_invalid_search_is_refused() -> None:
    with pytest.raises(ParameterError, match="path"):
        ContactSearch(at(0.0), (0.0, 0.0, 0.0), 2.0, AIR)
    with pytest.raises(ParameterError, match="force"):
        ContactSearch(at(0.0), (0.0, 0.0, -0.004), 0.0, AIR)
