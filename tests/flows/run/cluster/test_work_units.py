import pytest

from flows.run.cluster.work_units import RecordingEnd, RowRange, ShareResult, WorkUnit, partition_of

ROWS = RowRange("touch", 3, "touch/part-000001.parquet", "0" * 64, 10, 1010)
FOLDER, SOURCES = "/data/sessions/one", {"touch": (0, 3), "motion": (-1,)}
UNIT = WorkUnit("one", FOLDER, 1, 2, (3,), 12, 7, SOURCES, ((ROWS,), ()))
LAST = WorkUnit("one", FOLDER, 1, 2, (3, 5), 12, 8, SOURCES, (), RecordingEnd(57, 9, ((0,), (1,), (3, 5))))


@pytest.mark.parametrize("unit", [UNIT, LAST])
def test_a_unit_is_read_from_its_line(unit: WorkUnit) -> None:
    assert "\n" not in unit.to_line()
    assert WorkUnit.from_line(unit.to_line()) == unit


@pytest.mark.parametrize(("end", "error"), [(RecordingEnd(57, 9, ((0, 3),)), ""), (None, "damaged")])
def test_a_result_is_read_from_its_line(end: RecordingEnd | None, error: str) -> None:
    result = ShareResult("one", "/one", 0, 3, 10, end, error)
    assert ShareResult.from_line(result.to_line()) == result


def test_keys_name_session_generation_and_share() -> None:
    assert UNIT.key == "one/1/2"
    assert ShareResult("one", "/one", 1, 3, 10, None).key == "one/1"


def test_a_line_starts_with_its_partition() -> None:
    assert partition_of(UNIT.to_line()) == 12
    assert partition_of(ShareResult("one", "/one", 1, 3, 10, None).to_line()) == 10
