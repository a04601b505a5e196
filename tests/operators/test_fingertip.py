import json
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators import Pool, Touch, ms, s
from operators.errors import FingertipError, InputError, ParameterError
from operators.fingertip import TAKKTILE, Fingertip, grid, measured, rows_per_second

POOL = "Pool(groups=..., gain=..., unit='count')"
FALLING = "count, falling as pressure rises"
PAGE = "(docs/how-to/any-fingertip.md)"
PAD = Fingertip(grid(16), 1000.0, "kPa", 0.01, (0, 4000))


@pytest.mark.parametrize("fingertip", [TAKKTILE, PAD, replace(PAD, range=None)])
def test_a_description_in_json_is_read_back(fingertip: Fingertip) -> None:
    assert Fingertip.read(json.loads(json.dumps(fingertip.describe())), "card") == fingertip


@pytest.mark.parametrize(
    "wrong",
    [None, {}, {"layout": 3}, {"layout": [[0, 0]]}, {"rate_hz": "fast"}, {"range": [float("inf"), 0]}],
)
def test_an_invalid_description_names_the_file(wrong: dict[str, object] | None) -> None:
    content = wrong if not wrong else {**TAKKTILE.describe(), **wrong}
    with pytest.raises(InputError, match=r'^session\.json: has an invalid "fingertip"'):
        Fingertip.read(content, "session.json")


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"layout": ((0, 2),)}, "layout"),
        ({"layout": ()}, "layout"),
        ({"layout": (tuple(range(129)),)}, "layout"),
        ({"rate": 0.0}, "rate"),
        ({"resolution": -1.0}, "resolution"),
        ({"unit": ""}, "unit"),
        ({"range": (5, 5)}, "range"),
    ],
)
def test_an_impossible_fingertip_is_refused(change: dict[str, object], name: str) -> None:
    with pytest.raises(ParameterError, match=f"Fingertip: {name} is"):
        replace(TAKKTILE, **cast("Any", change))


@pytest.mark.parametrize(
    ("given", "needs", "fix"),
    [
        (replace(TAKKTILE, rate=200.0), "100 Hz", f"Resample(rate=100) in a flow converts it {PAGE}"),
        (replace(TAKKTILE, range=(0, 1023)), FALLING, f"Pool(gain=-1) in a flow converts it {PAGE}"),
        (PAD, f"6 cells, {FALLING}, 100 Hz", f"{POOL} and Resample(rate=100) in a flow convert it {PAGE}"),
    ],
)
def test_a_mismatch_names_the_operators_that_convert_it(given: Fingertip, needs: str, fix: str) -> None:
    with pytest.raises(FingertipError) as caught:
        TAKKTILE.check_fits("tcn", given)
    assert (caught.value.owner, caught.value.needs, caught.value.fix) == ("tcn", needs, fix)


def test_readings_in_other_steps_of_a_unit_fit_after_the_named_pool() -> None:
    fine = Fingertip(grid(4), 100.0, unit="kPa", resolution=0.01, range=(0, 30000))
    coarse = replace(fine, resolution=0.1, range=(300, 0))
    with pytest.raises(FingertipError, match=r": Pool\(gain=-10\) in a flow converts it"):
        fine.check_fits("own", coarse)
    fine.check_fits("own", Pool(gain=-10).output_fingertip(coarse))


def test_a_rate_within_a_tenth_and_an_unknown_range_fit() -> None:
    TAKKTILE.check_fits("tcn", replace(TAKKTILE, rate=95.0, range=None))


def test_ranges_are_compared_in_counts_and_not_in_a_physical_unit() -> None:
    finer = replace(TAKKTILE, range=(4092, 0))
    assert [each.ratio(finer) for each in (TAKKTILE, replace(TAKKTILE, unit="kPa"))] == [4, 1]


def test_cells_and_rate_are_measured_if_nothing_states_them() -> None:
    rows = replace(Touch.zeros(5, 16), time=np.arange(5) * ms)
    found = measured(rows)
    assert found is not None
    assert (found.cells, found.rate) == (16, 1000.0)
    assert measured(Touch.zeros(9)) is None  # all rows have one time: no default
    slow = np.arange(600) * 10**16  # 2**63 ns are less than twice its span
    assert rows_per_second(slow) == pytest.approx(1e-7)


@given(
    packets=st.lists(st.integers(1, 9), min_size=20, max_size=60),
    rate=st.floats(20, 4000),
    step=st.sampled_from([1, 1_000, 1_000_000]),
    pause=st.booleans(),
)
def test_the_rate_is_rows_over_time(packets: list[int], rate: float, step: int, *, pause: bool) -> None:
    size = sum(packets)
    time = (np.arange(size) * (s / rate)).astype(np.int64)
    time[size // 2 :] += 500 * s * pause
    packed = np.repeat(time[np.cumsum([0, *packets[:-1]])], packets)  # rows of a USB packet share a time
    for stamps in (time // step * step, packed, packed[::-1]):
        found = rows_per_second(stamps)
        assert found == pytest.approx(rate, rel=20 / size + 4 * step * rate / s / size)
