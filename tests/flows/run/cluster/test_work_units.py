from dataclasses import replace

import pytest

from flows.run.cluster.work_units import RecordingEnd, RowRange, UnitResult, WorkUnit, receiver_of

ROWS = RowRange("touch", 3, "touch/part-000001.parquet", "0" * 64, 10, 1010)
FOLDER, SOURCES = "/data/sessions/one", {"touch": (0, 3), "motion": (-1,)}
UNIT = WorkUnit("one", FOLDER, 10, 1, 2, (3,), 7, SOURCES, ((ROWS,), ()))
LAST = WorkUnit("one", FOLDER, 10, 1, 2, (3, 5), 8, SOURCES, (), RecordingEnd(57, 9, 3))


@pytest.mark.parametrize("unit", [UNIT, LAST])
def test_a_unit_is_read_from_its_line(unit: WorkUnit) -> None:
    assert "\n" not in unit.to_line()
    assert WorkUnit.from_line(unit.to_line()) == unit


@pytest.mark.parametrize("result", [UnitResult.of(LAST, ({},)), UnitResult.of(UNIT, error="damaged")])
def test_a_result_is_read_from_its_line(result: UnitResult) -> None:
    assert UnitResult.from_line(result.to_line()) == result


def test_keys_name_session_generation_share_and_unit() -> None:
    assert UNIT.key == "one/1/2"
    assert UnitResult.of(UNIT).key == "one/1/2/7"


def test_the_last_result_of_a_share_names_all_results_of_the_session() -> None:
    last = UnitResult.of(replace(LAST, end=RecordingEnd(57, 2, 2)))
    assert last.all_keys() == [["one/1/0/0", "one/1/0/1"], ["one/1/1/0", "one/1/1/1"]]
    assert UnitResult.of(UNIT).all_keys() == []


def test_a_line_starts_with_its_receiver() -> None:
    assert receiver_of(UNIT.to_line()) == 12
    assert receiver_of(UnitResult.of(UNIT).to_line()) == 10
