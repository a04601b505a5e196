import numpy as np
import polars as pl
import pytest

from flows.report.results import Metrics, area, estimate_table, estimates, joined, median, result_rows, share

STATISTICS = {
    "missed %": share("missed slips", "slips", 100),
    "delay ms": median("delay ms"),
    "AUC %": area("if slip", "if static"),
}


def study(recordings: int = 4) -> pl.DataFrame:
    """Return results of two methods; the second one misses everything and has no delay."""
    random, parts = np.random.default_rng(3), list[pl.DataFrame]()
    for number in range(recordings):
        metrics: Metrics = {
            "slips": 10,
            "missed slips": number,
            "delay ms": random.normal(30, 10, 10 - number),
            "if slip": random.normal(1, 1, 50).round(1),
            "if static": random.normal(0, 1, 70).round(1),
        }
        parts.append(result_rows(metrics, method="tcn", recording=str(number)))
        parts.append(result_rows({"slips": 10, "missed slips": 10}, method="none", recording=str(number)))
    return joined(parts)


def test_a_statistic_is_that_of_all_values_together() -> None:
    results = study()
    found = estimates(results, STATISTICS).filter(method="tcn")
    of = {name: part["value"].to_numpy() for (name,), part in results.filter(method="tcn").group_by("metric")}
    wins = of["if slip"][:, None] > of["if static"]
    ties = of["if slip"][:, None] == of["if static"]
    expected = [15.0, np.median(of["delay ms"]), 100 * (wins + ties / 2).mean()]
    assert found["value"].to_list() == pytest.approx(expected)


def test_an_interval_is_that_of_recordings_drawn_with_replacement() -> None:
    results, random, drawn = study(), np.random.default_rng(5), list[pl.DataFrame]()
    for _ in range(400):
        chosen = [
            results.filter(method="tcn", recording=str(number)).with_columns(recording=pl.lit(str(place)))
            for place, number in enumerate(random.integers(0, 4, 4))
        ]
        drawn.append(estimates(joined(chosen), STATISTICS, draws=0))
    naive = pl.concat(drawn).group_by("statistic", maintain_order=True)
    limits = naive.agg(low=pl.col("value").quantile(0.025), high=pl.col("value").quantile(0.975))
    found = estimates(results, STATISTICS).filter(method="tcn")
    for name, tolerance in (("missed %", 1.5), ("delay ms", 3.0)):
        for side in ("low", "high"):
            [expected], [value] = (each.filter(statistic=name)[side].to_list() for each in (limits, found))
            assert value == pytest.approx(expected, abs=tolerance)


def test_a_median_between_two_values_has_the_interval_of_the_same_median() -> None:
    results = [result_rows({"delay ms": [10, 30]}, method="", recording=str(number)) for number in range(3)]
    found = estimates(joined(results), {"delay ms": median("delay ms")})
    assert found.select("value", "low", "high").row(0) == (20, 20, 20)


def test_unknown_values_are_null_and_few_recordings_have_no_interval() -> None:
    found = estimates(study(), STATISTICS).filter(method="none")
    assert found["value"].to_list() == [100, None, None]
    assert found["low"].to_list() == [100, None, None]
    assert estimates(study(2), STATISTICS)["low"].is_null().all()


def test_a_table_shows_an_interval_beside_its_value() -> None:
    table = estimate_table(estimates(study(), STATISTICS), {"delay ms": 0}, intervals=["missed %"])
    assert table.head == ["method", "missed %", "95 %", "delay ms", "AUC %"]
    assert table.rows[0][:3] == ["tcn", 15, "5.0 to 25.0"]
    assert table.rows[1][3:] == [None, None]
    both = estimate_table(estimates(study(), STATISTICS), {}, intervals=["missed %", "delay ms"]).json()
    assert [both["rows"][0][f"{name} 95 %"] for name in ("missed %", "delay ms")] == [
        "5.0 to 25.0",
        "27.7 to 33.0",
    ]
