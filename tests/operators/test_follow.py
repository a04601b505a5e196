from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from operators import TAKKTILE, Fingertip, FingertipError, Follow, ParameterError, Touch, Zero, Zeroed, s
from operators.batch import Reals

_RATE = 100  # Hz


def _touch(load: Reals, *, temperature: Reals | None = None, cells: int = 6, noise: float = 0.6) -> Touch:
    """Rows 10 ms apart of a noisy fingertip at 450 counts; load (n,) or (n, cells) is added."""
    shape = len(load), cells
    level = 450 + noise * np.random.default_rng(0).standard_normal(shape) + load.reshape(len(load), -1)
    warmth = np.zeros(shape) if temperature is None else np.repeat(temperature[:, None], cells, axis=1)
    time = np.arange(len(load)) * s // _RATE
    counts = np.rint(level).astype(np.int16)
    return Touch(time, counts, np.rint(warmth).astype(np.int16), np.ones(shape, np.bool_))


def _seconds(length: float) -> Reals:
    return np.arange(round(length * _RATE)) / _RATE


def _last(zeroed: Zeroed, seconds: float = 2) -> float:
    """Mean count of the last seconds."""
    return float(zeroed.counts[-round(seconds * _RATE) :].mean())


def _vibrating(load: Reals) -> Reals:
    """A load with the vibration of an arm, of 4 counts."""
    return load + np.where(load < 0, 4 * np.sin(2 * np.pi * 6.5 * _seconds(len(load) / _RATE)), 0)


def test_without_drift_a_contact_reads_as_with_zero() -> None:
    t = _seconds(30)
    touch = _touch(_vibrating(np.where(t > 2, -80.0, 0.0)))
    assert np.array_equal(Follow().push(touch).counts, Zero().push(touch).counts)


@pytest.mark.parametrize("cells", [1, 4, 16])
@pytest.mark.parametrize("rate", [0.2, -0.2])
def test_slow_drift_in_air_is_followed_for_any_number_of_cells(cells: int, rate: float) -> None:
    touch = _touch(rate * _seconds(200), cells=cells)
    assert abs(_last(Zero().push(touch))) > 35
    assert abs(_last(Follow().push(touch))) < 2


@pytest.mark.parametrize("rate", [20.0, -20.0])
def test_the_slope_of_the_first_samples_goes_on_in_contact(rate: float) -> None:
    t = _seconds(15)
    touch = _touch(rate * t + _vibrating(np.where(t > 1.2, -80.0, 0.0)))
    assert abs(_last(Follow().push(touch)) + 80) < 20
    assert abs(_last(Zero().push(touch)) + 80) > 200


def test_a_press_that_begins_in_the_first_samples_is_not_a_slope() -> None:
    t = _seconds(10)
    touch = _touch(np.where(t > 0.8, -30.0, 0.0))
    assert abs(_last(Follow().push(touch)) + 30) < 1


@pytest.mark.parametrize("rate", [0.5, 1.0, 30.0])
def test_a_slow_press_is_preserved_while_it_is_held_quietly(rate: float) -> None:
    press = -np.clip((_seconds(400) - 10) * rate, 0, 60)
    assert _last(Follow().push(_touch(press))) < -55


def test_a_press_slower_than_the_rate_is_followed_like_drift() -> None:
    press = -np.clip((_seconds(400) - 10) * 0.2, 0, 60)
    assert abs(_last(Follow().push(_touch(press)))) < 2
    assert _last(Follow(rate=0.05).push(_touch(press))) < -55


def test_a_press_on_two_of_six_cells_moves_no_baseline_of_these() -> None:
    press = np.zeros((60 * _RATE, 6))
    press[10 * _RATE :, 2:4] = -12.0
    counts = Follow().push(_touch(press)).counts[-_RATE:].mean(axis=0)
    assert np.abs(counts - press[-1]).max() < 1


def test_temperature_is_followed_in_contact() -> None:
    t = _seconds(120)
    warmth = 500 - np.clip(t - 20, 0, 50)
    touch = _touch(_vibrating(np.where(t > 5, -80.0, 0.0)) - 0.3 * (warmth - 500), temperature=warmth)
    assert abs(_last(Zero().push(touch)) + 80) > 13
    assert abs(_last(Follow().push(touch)) + 80) < 1


def test_the_temperature_coefficient_is_learned_in_air() -> None:
    t = _seconds(600)
    warmth = 500 + 20 * np.sin(2 * np.pi * t / 200)
    touch = _touch(-0.5 * (warmth - 500), temperature=warmth)
    contact = _touch(
        -80.0 - 0.5 * np.clip(t[: 60 * _RATE], 0, 30), temperature=500 + np.clip(t[: 60 * _RATE], 0, 30)
    )
    follow = Follow()
    follow.push(touch)
    later = replace(contact, time=contact.time + 600 * s)
    assert abs(_last(follow.push(later)) + 80) < 2


def test_after_a_contact_the_drift_that_it_hid_is_removed() -> None:
    t = _seconds(120)
    load = _vibrating(np.where((t > 5) & (t < 90), -80.0, 0.0)) - np.clip(0.2 * (t - 10), 0, 12)
    touch = _touch(load)
    assert _last(Zero().push(touch)) < -11
    assert abs(_last(Follow().push(touch))) < 1


def test_a_grip_reduced_to_a_third_is_preserved() -> None:
    t = _seconds(120)
    touch = _touch(np.where(t > 30, -30.0, np.where(t > 3, -90.0, 0.0)))
    assert abs(_last(Follow().push(touch)) + 30) < 1


def test_a_start_under_load_is_corrected_once_it_is_lifted() -> None:
    t = _seconds(90)
    touch = _touch(np.where(t < 5, -50.0, 0.0))
    assert _last(Zero().push(touch)) > 49
    assert abs(_last(Follow().push(touch))) < 1


def test_recovery_of_the_rubber_between_two_contacts_is_not_drift() -> None:
    t = _seconds(14)
    load = np.where((t > 3) & (t < 5), -80.0, np.where(t >= 5, 4.0 * np.exp(-(t - 5) / 10), 0.0))
    touch = _touch(load)
    assert np.array_equal(Follow().push(touch).counts, Zero().push(touch).counts)


def test_a_noisy_cell_does_not_keep_the_others_from_following() -> None:
    load = np.repeat(0.1 * _seconds(200)[:, None], 6, axis=1)
    load[:, 5] += 10 * np.random.default_rng(1).standard_normal(len(load))
    assert np.abs(Follow().push(_touch(load)).counts[-200:, :5].mean(axis=0)).max() < 1


def test_a_cell_that_never_answered_stays_invalid() -> None:
    touch = _touch(np.zeros(300))
    valid = touch.valid.copy()
    valid[:150, 4] = False
    zeroed = Follow().push(replace(touch, valid=valid))
    assert zeroed.valid.all(axis=0).tolist() == [True] * 4 + [False, True]
    assert not zeroed.valid[:, 4].any()


def test_a_short_stream_is_zeroed_at_its_end() -> None:
    follow = Follow()
    assert len(follow.push(_touch(np.zeros(50)))) == 0
    assert len(follow.flush()) == 50
    assert len(follow.flush()) == 0


def test_zeroed_input_passes_unchanged() -> None:
    touch = _touch(np.zeros(5))
    zeroed = Zeroed(touch.time, touch.counts, touch.temperature, touch.valid)
    assert Follow(scans=2).push(zeroed) is zeroed


def test_a_fingertip_whose_counts_rise_with_pressure_is_refused() -> None:
    assert Follow().output_fingertip(TAKKTILE) is TAKKTILE
    with pytest.raises(FingertipError, match=r"insert Pool\(gain=-1\)"):
        Follow().output_fingertip(Fingertip(((0, 1),), 100.0, range=(0, 1000)))


@pytest.mark.parametrize("parameters", [{"rate": 0.0}, {"quiet": 0.0}, {"scans": 0}])
def test_parameters_out_of_range_are_refused(parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=r"^Follow: "):
        Follow(**parameters)
