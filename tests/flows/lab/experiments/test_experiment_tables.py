from collections.abc import Callable

from flows.lab.experiments import experiment_tables as tables
from flows.lab.experiments.experiment import Found, Kind


def test_failures_are_counted_by_how(found: Callable[[Kind], Found]) -> None:
    section = tables.failures(found("tap"))
    [table] = section.tables
    assert section.title == "psd, ours fails in 1 of 4 trials, mostly by: too late"
    assert table.rows[0] == ["psd, ours", "ball", "1 too late"]
    assert all(row[:2] != ["psd, ours", "box"] for row in table.rows)


def test_costs_have_a_row_for_each_object_and_one_for_all(found: Callable[[Kind], Found]) -> None:
    [table] = tables.costs(found("lift")).tables
    assert [row[:4] for row in table.rows[:3]] == [
        ["psd, ours", "ball", "16.5", "27.3"],
        ["psd, ours", "box", "3.0", "3.0"],
        ["psd, ours", "all", "3.0", "21.9"],
    ]


def test_alarms_count_the_blows_that_were_drawn_and_the_false_slips(found: Callable[[Kind], Found]) -> None:
    [table] = tables.alarms(found("tap")).tables
    assert table.rows[2] == ["psd, ours", "all", "2.0", "30", "6", "25.0", "25.0", "0.0"]
