"""Readings in any unit as counts of 16 bits, and their fingertip."""

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.files.readings import COUNT_LIMIT, offsets, resolution_of
from connectors.files.trace import interpreted
from operators.batch import Reals, Touch, Zeroed
from operators.errors import InputError, ParameterError
from operators.fingertip import Fingertip


def columns(unit: str = "count", resolution: float | None = None, *, zeroed: bool | None = None) -> ColumnMap:
    return ColumnMap({}, {"counts": unit}, resolution=resolution, zeroed=zeroed)


def table(*readings: list[float], dtype: str = "f8") -> pl.DataFrame:
    cells = {f"p{i}": np.array(each, dtype) for i, each in enumerate(readings)}
    return pl.DataFrame({"t": np.arange(len(readings[0])) / 100, **cells})


finite = st.floats(-1e9, 1e9, allow_nan=False).map(lambda value: round(value, 9))


@given(st_numpy.arrays(np.float64, st.tuples(st.integers(1, 20), st.integers(1, 4)), elements=finite))
def test_readings_come_back_within_half_a_step_that_is_as_fine_as_16_bits_allow(values: Reals) -> None:
    for zeroed in (False, True):
        resolution = resolution_of(values, offset=not zeroed)
        offset = np.zeros(values.shape[1]) if zeroed else offsets(values, resolution)
        counts = np.rint(values / resolution - offset)
        assert np.abs(counts).max() <= COUNT_LIMIT
        assert np.abs((counts + offset) * resolution - values).max() <= 0.51 * resolution
        span = np.abs(values).max() if zeroed else (values.max(axis=0) - values.min(axis=0)).max()
        lossless = np.allclose((counts + offset) * resolution, values, rtol=0, atol=0.011 * resolution)
        assert (
            lossless
            or resolution <= 2.5 * max(span / (COUNT_LIMIT - 1), 1e-10 * np.abs(values).max(), 1e-12) * 2.01
        )


@pytest.mark.parametrize(
    ("readings", "unit", "resolution", "offset"),
    [
        ([0, 500, 1023], "count", 1, False),
        ([37084, 38580, 37091], "count", 1, True),  # 16 bits without a sign
        ([101.32, 101.35, 99.99], "kPa", 0.01, False),
        ([0.0, 3.141592, 5.0], "V", 0.0002, False),
        ([98270.25, 143262.0, 98000.75], "Pa", 1, True),
        ([98270.25, 98262.0, 98271.75], "Pa", 0.25, True),
        ([0.0, 0.0, 0.0], "N", 1, False),
        ([0.125, 0.375, 2.0], "N", 0.025, False),
        ([0.0012, 0.0041, 5.0007], "N", 0.0001, True),  # noise of less than a hundredth of 1 N
    ],
)
def test_the_resolution_keeps_all_digits_if_it_can(
    readings: list[float], unit: str, resolution: float, *, offset: bool
) -> None:
    trace = Trace(table(readings), columns(unit))
    assert trace.part.resolution == resolution
    assert trace.part.offset.any() == offset
    given_back = (trace.part.touch.counts + trace.part.offset) * resolution
    assert given_back[:, 0] == pytest.approx(readings, abs=resolution * 0.51)
    fingertip = trace.fingertip(Touch)
    assert fingertip is not None
    assert (fingertip.unit, fingertip.resolution) == (unit, resolution)


def test_readings_of_32_bit_floats_have_the_resolution_of_their_decimals() -> None:
    trace = Trace(table([101.32, 101.35, 99.99], dtype="f4"), columns("kPa"))
    assert trace.part.resolution == 0.01


def test_readings_relative_to_the_unloaded_fingertip_have_no_offset() -> None:
    pressures = table([98270.25, 143262.0, 98000.75])
    for zeroed, resolution in ((True, 5), (False, 1)):
        trace = Trace(pressures, columns("Pa", zeroed=zeroed))
        assert type(trace.part.touch) is (Zeroed if zeroed else Touch)
        assert trace.part.resolution == resolution
        assert trace.part.offset.any() != zeroed
    assert type(Trace(table([-0.5, 2.0]), columns("N")).part.touch) is Zeroed
    assert type(Trace(table([-0.5, 2.0]), columns("N", zeroed=False)).part.touch) is Touch


def test_a_part_that_begins_loaded_is_a_warning_of_this_part_only() -> None:
    unloaded, loaded = ([500.0] * rows + [400.0] * (300 - rows) for rows in (150, 50))
    for first, second in ((unloaded, loaded), (loaded, unloaded)):
        time = [*np.arange(300) / 100] * 2
        parts = interpreted({"t": time, "p0": first + second, "p1": [500.0] * 600}, split=True)
        doubts = [any("change in the first second" in each for each in part.warnings) for part in parts]
        assert doubts == [first is loaded, second is loaded]


def test_a_given_resolution_is_kept_and_must_fit() -> None:
    trace = Trace(table([0.1234, 5.0]), columns("V", 0.01))
    assert trace.part.touch.counts[:, 0].tolist() == [12, 500]
    assert "the readings are rounded to steps of 0.01 V" in trace.part.warnings
    assert Trace(table([2.5, 1000]), columns(resolution=0.5)).part.touch.counts[:, 0].tolist() == [5, 2000]
    with pytest.raises(InputError, match=r"row 1, column p0: is 5.0, must be from -3.2767 to 3.2767 at a"):
        _ = Trace(table([0.0, 5.0, -5.0]), columns("V", 1e-4)).part.touch


@pytest.mark.parametrize(("cell", "value", "step"), [(0, 3.2e6, 100), (1, 7e6, 250)])
def test_an_automatic_resolution_that_destroys_a_signal_is_refused_with_its_cause(
    cell: int, value: float, step: int
) -> None:
    cells = np.round(101 + np.random.default_rng(0).random((3, 200)), 3)
    cells[2] = 1.0  # broken
    cells[cell, 40] = value
    frame, text = table(*cells.tolist()), "counts=p0..p2,units.counts=kPa"
    remedy = f"state missing={value:.0f} if row 40, column p{cell} is no reading, or state resolution={step}"
    with pytest.raises(InputError, match=f"steps of {step} kPa make p0 p1 almost constant: {remedy}$"):
        _ = Trace(frame, ColumnMap.parse(text)).part
    without = ColumnMap.parse(f"{text},missing={value}")
    assert Trace(frame, without).part.resolution == 0.001
    rounded = Trace(frame, ColumnMap.parse(f"{text},resolution=10000")).part
    assert "the readings are rounded to steps of 10000 kPa" in rounded.warnings
    cells[0, 40], cells[1:] = cells[0, 41], np.arange(200) * 1e6  # one cell of a smaller magnitude
    [warning] = [
        each
        for each in Trace(table(*cells.tolist()), ColumnMap.parse(text)).part.warnings
        if "almost" in each
    ]
    assert warning.startswith("steps of 10000 kPa make p0 almost constant: state missing=0 if row")


@pytest.mark.parametrize("value", [-999.9, 9999.99, -1e30, 2.0**31 - 1, -(2.0**31), 5e7])
def test_a_value_for_no_reading_does_not_make_a_quiet_signal_constant(value: float) -> None:
    cells = [[100 + k * 7 % 9 / 100 for k in range(60)] for _ in range(2)]
    cells[1][40] = value
    if value == 5e7:  # of no known meaning
        with pytest.raises(
            InputError, match=r"state missing=50000000 if row 40, column p1 is no reading, or state"
        ):
            _ = Trace(table(*cells), columns("kPa")).part
        return
    found = Trace(table(*cells), columns("kPa")).part
    assert (found.resolution, np.argwhere(~found.touch.valid).tolist()) == (0.01, [[40, 1]])
    assert "row 40, column p1 is" in found.warnings[0]


@pytest.mark.parametrize("rates", [(60, 125), (60, 500), (100, 30)])
def test_rows_of_streams_that_were_merged_are_refused_and_lost_rows_are_not(rates: tuple[int, int]) -> None:
    rows = sorted((k / rate, rate == rates[0]) for rate in rates for k in range(3 * rate))
    readings = [500 + k % 3 if own else None for k, (_, own) in enumerate(rows)]
    frame = {"t": [time for time, _ in rows], "p0": readings}
    with pytest.raises(InputError, match=r"only .* of .* rows have readings, as in merged streams"):
        interpreted(frame, ColumnMap.parse("counts=p0"))
    for lost in (set(range(100, 400)), {*np.random.default_rng(0).choice(600, 120, replace=False).tolist()}):
        readings = [None if k in lost else 500 + k % 3 for k in range(600)]
        [part] = interpreted({"t": np.arange(600) / 100, "p0": readings}, ColumnMap.parse("counts=p0"))
        assert part.columns.rate == pytest.approx(100)


@pytest.mark.parametrize(
    ("usual", "rare", "missing"),
    [(3.0, 99.0, ()), (3.0, 999.0, ()), (99.9, -999.0, (-999,)), (9999.0, -999.0, (-999,))],
)
def test_a_saturated_or_quiet_cell_is_not_missing(
    usual: float, rare: float, missing: tuple[float, ...]
) -> None:
    cells = [usual] * 50 + [rare] * 10
    assert Trace(table(cells, cells), columns("kPa")).part.columns.missing == missing


def described(text: str, cells: int = 4, base: float = 100) -> Fingertip:
    readings = {f"c{cell}": [base + 10 * cell + k % 7 for k in range(9)] for cell in range(cells)}
    trace = Trace({"t": np.arange(9) / 100, **readings}, ColumnMap.parse(text))
    found = trace.fingertip(Touch)
    assert found is not None
    return found


def test_a_fingertip_has_the_stated_layout_and_range() -> None:
    found = described("layout=4x1,range=0:4000")
    assert (found.layout, found.range, found.falls) == (((0,), (1,), (2,), (3,)), (0, 4000), False)
    found = described("layout=3, 2, 1/-1, 0, -1,range=4095:0")
    assert (found.layout, found.falls) == (((3, 2, 1), (-1, 0, -1)), True)
    found = described("")
    assert (found.layout, found.range, found.falls) == (((0, 1), (2, 3)), None, None)
    with pytest.raises(ParameterError, match=r"layout is '0,1,2/3,4,5/6,7,8', must be of 4 cells"):
        described("layout=3x3")
    with pytest.raises(ParameterError, match="must be rows that name each cell from 0 on once"):
        described("layout=0,1/2,2")
    with pytest.raises(ParameterError, match="must be two different counts"):
        described("range=5:5")


@pytest.mark.parametrize(
    ("text", "bases"),
    [
        ("range=0:65535", (500, 32_700, 40_000, 40_101, 65_000)),  # counts of 16 bits
        ("range=65535:0,resolution=2", (500, 40_000, 40_101)),
        ("range=50.3:115.1,units.counts=kPa,resolution=0.001", (50.3, 80, 101.3, 101.3715, 114)),
    ],
)
def test_files_of_one_sensor_have_ranges_of_one_width(text: str, bases: tuple[float, ...]) -> None:
    found = [described(text, base=base) for base in bases]
    widths = {each.range[1] - each.range[0] for each in found if each.range}
    assert len(widths) == 1
    assert {each.ratio(other) for each in found for other in found} == {1}


def test_cells_that_never_change_and_readings_outside_the_range_are_warnings() -> None:
    moving, fixed = [100.0 + k % 9 for k in range(100)], [101.3] * 100
    doubts = [
        "all readings of p1 are the same: is the cell broken?",
        "readings are outside the stated range, 0 to 105",
    ]
    assert Trace(table(moving, fixed), ColumnMap.parse("range=105:0,units.counts=kPa")).part.warnings == (
        *doubts,
    )
    assert Trace(table(moving, moving), ColumnMap.parse("range=0:108")).part.warnings == ()


def test_a_range_in_the_unit_of_the_file_becomes_counts() -> None:
    assert described("range=0:1e9").range == (0, 1_000_000_000)
    found = described("range=100000:101000,units.counts=Pa", base=100_000)
    assert found.range is not None
    assert (found.resolution, found.range[1] - found.range[0]) == (1, 1000)
    assert abs(found.range[0]) < 32767
