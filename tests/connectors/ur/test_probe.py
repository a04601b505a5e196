from math import nan

import pytest

from connectors.ur.probe import MEAN, OVERRUN, Probe, mean_force
from connectors.ur.ur_state import State
from operators import ParameterError

REST = (0.0,) * 6
AIR = (1.0, -2.0, 5.0)  # N that the arm is told in the air


def at(z: float, push: float = 0.0) -> State:
    """An arm at a height (m), pushed up (N) beside what it is told in the air."""
    return State((0.0, 0.0, z, 0.0, 0.0, 0.0), REST, (AIR[0], AIR[1], AIR[2] + push))


def probe() -> Probe:
    return Probe(at(0.0), (0.0, 0.0, -0.004), 2.0, AIR)


def test_what_is_told_in_the_air_is_no_contact() -> None:
    down = probe()
    assert not any(down.look(at(-0.0001 * step)) for step in range(30))
    assert down.push == pytest.approx(0.0)


def test_beyond_its_longest_way_it_overruns_once_it_should_stand() -> None:
    down = probe()
    assert not down.overruns(at(-0.004 - 0.9 * OVERRUN))
    assert down.overruns(at(-0.0052)) == "it went 1.2 mm beyond the 4.0 mm that it might seek contact"


def test_contact_is_felt_once_the_mean_of_the_newest_states_says_so() -> None:
    down = probe()
    assert not any(down.look(at(-0.001, 2.1)) for _ in range(MEAN - 1))
    assert down.look(at(-0.001, 2.1))
    assert down.felt


def test_one_state_that_is_wrong_is_no_contact() -> None:
    down = probe()
    for push in (0.0, 0.0, 7.0, 0.0, 0.0):
        assert not down.look(at(-0.001, push))


def test_a_push_from_the_side_or_behind_is_no_contact() -> None:
    down = probe()
    for _ in range(10):
        assert not down.look(at(-0.001, -9.0))
        assert not down.look(State((0, 0, -0.001, 0, 0, 0), REST, (9.0, 9.0, 5.0)))


def test_the_way_ends_without_contact() -> None:
    down = probe()
    assert not down.look(at(-0.0039))
    assert down.look(at(-0.0041))
    assert not down.felt


def test_a_force_that_is_unknown_is_none() -> None:
    assert mean_force([at(0.0), State(at(0.0).pose, REST)]) is None
    assert mean_force([at(0.0), at(0.0, 1.0)]) == pytest.approx((1.0, -2.0, 5.5))
    down = Probe(at(0.0), (0.0, 0.0, -0.004), 2.0, (nan, nan, nan))
    assert not any(down.look(at(-0.001, 9.0)) for _ in range(10))


def test_a_probe_that_cannot_be_is_refused() -> None:
    with pytest.raises(ParameterError, match="way"):
        Probe(at(0.0), (0.0, 0.0, 0.0), 2.0, AIR)
    with pytest.raises(ParameterError, match="force"):
        Probe(at(0.0), (0.0, 0.0, -0.004), 0.0, AIR)
