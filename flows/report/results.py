"""Results of studies: one long table, and the statistics that are computed from it.

A study writes down what it counted and measured on each recording, such as the number of ``false alarms`` or
the ``delay ms`` of each slip. A statistic combines the metrics of a group of recordings, so each table of a
report is a group-by. An interval repeats it on recordings that are drawn with replacement: samples of a
recording are alike, so recordings are drawn, not samples.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
import polars as pl
from numpy.typing import NDArray

from flows.report.table import INTERVAL, Table, Value

Values: TypeAlias = NDArray[np.float64]
Metrics: TypeAlias = Mapping[str, float | Values | Sequence[float]]

COLUMNS: Final[Mapping[str, type[pl.DataType]]] = {
    "method": pl.String,
    "recording": pl.String,
    "condition": pl.String,  # stress, kind of motion or experimental condition; empty: as recorded
    "fold": pl.String,  # what was held out; empty: nothing
    "metric": pl.String,
    "value": pl.Float64,  # a metric may have several values on one recording
}
DRAWS: Final = 1000
_LEAST: Final = 3  # recordings: fewer give no interval
_TAILS: Final = (0.025, 0.975)


def result_rows(
    metrics: Metrics, *, method: str, recording: str, condition: str = "", fold: str = ""
) -> pl.DataFrame:
    """Return the rows of one recording.

    Args:
        metrics: A value, or several, by metric.
        method: What was judged.
        recording: Name, unique within the study.
        condition: What differs from the nominal condition.
        fold: What was held out.

    >>> result_rows({"slips": 2, "delay ms": [10, 30]}, method="psd", recording="a")["value"].to_list()
    [2.0, 10.0, 30.0]
    """
    parts = {metric: np.atleast_1d(np.asarray(value, np.float64)) for metric, value in metrics.items()}
    names = np.repeat(np.array(list(parts), np.object_), [len(each) for each in parts.values()])
    values = np.concatenate([np.empty(0), *parts.values()])
    key = {"method": method, "recording": recording, "condition": condition, "fold": fold}
    types = {name: COLUMNS[name] for name in ("metric", "value")}
    frame = pl.DataFrame({"metric": names.tolist(), "value": values}, types)
    return frame.select(*(pl.lit(text).alias(name) for name, text in key.items()), "metric", "value")


def joined(results: Iterable[pl.DataFrame] = ()) -> pl.DataFrame:
    """Return one table of several; an empty one if there are none."""
    return pl.concat([pl.DataFrame(schema=dict(COLUMNS)), *results])


class Recordings:
    """The metrics of a group of recordings.

    >>> table = [result_rows({"slips": n}, method="psd", recording=f"{n}") for n in (2, 3)]
    >>> group = Recordings(joined(table))
    >>> group.sums("slips"), group.sums("misses")
    (array([2., 3.]), array([0., 0.]))
    """

    def __init__(self, results: pl.DataFrame) -> None:
        self.names = results["recording"].unique(maintain_order=True).to_list()
        place = {name: number for number, name in enumerate(self.names)}
        self._parts = {
            str(metric): (
                part["recording"].replace_strict(place, return_dtype=pl.Int64).to_numpy(),
                part["value"].to_numpy(),
            )
            for (metric,), part in results.group_by("metric", maintain_order=True)
        }

    def values(self, metric: str) -> tuple[NDArray[np.intp], Values]:
        """Return the place of the recording of each value (k,), and the values (k,)."""
        return self._parts.get(metric, (np.empty(0, np.intp), np.empty(0)))

    def sums(self, metric: str) -> Values:
        """Return the sum of a metric on each recording; (recordings,)."""
        places, values = self.values(metric)
        return np.bincount(places, values, len(self.names)).astype(np.float64)


@dataclass(frozen=True, slots=True)
class Statistic:
    """A number that is computed from the metrics of a group of recordings."""

    of: Callable[[Recordings], float]  # NaN: unknown
    # in draws that have each recording as often as weights (draws, recordings); (draws,); None: no interval
    drawn: Callable[[Recordings, Values], Values] | None = None


def of_sums(compute: Callable[[Callable[[str], Values]], Values]) -> Statistic:
    """Return a statistic of the sums of metrics over the recordings, such as a share.

    Args:
        compute: Takes a function that returns the sum of a metric in each draw (draws,), and returns the
            statistic (draws,).
    """

    def drawn(group: Recordings, weights: Values) -> Values:
        return compute(lambda metric: weights @ group.sums(metric))

    return Statistic(lambda group: float(drawn(group, np.ones((1, len(group.names))))[0]), drawn)


def share(part: str, whole: str, scale: float = 1.0) -> Statistic:
    """Return the statistic that divides the sum of a metric by that of another."""
    return of_sums(lambda total: scale * ratio(total(part), total(whole)))


def rate(part: str, whole: str) -> Statistic:
    """Return the share (%) of independent trials, with Jeffreys' interval: it is wide even at 0 and 100 %."""

    def drawn(group: Recordings, weights: Values) -> Values:
        hits, count = group.sums(part).sum(), group.sums(whole).sum()
        if not count:
            return np.full(len(weights), np.nan)
        return 100 * np.random.default_rng(0).beta(hits + 0.5, count - hits + 0.5, len(weights))

    return Statistic(share(part, whole, 100).of, drawn)


def median(metric: str) -> Statistic:
    """Return the median of all values of a metric."""

    def of(group: Recordings) -> float:
        _, values = group.values(metric)
        return float(np.median(values)) if len(values) else np.nan

    def drawn(group: Recordings, weights: Values) -> Values:
        owners, values = group.values(metric)
        if not len(values):
            return np.full(len(weights), np.nan)
        order = np.argsort(values)
        passed = np.cumsum(weights[:, owners[order]], axis=1)  # (draws, k)
        middle = [less(passed, passed[:, -1:] / 2).sum(axis=1) for less in (np.less, np.less_equal)]
        found = values[order].take(middle, mode="clip").mean(axis=0)  # of both middle ones
        return np.where(passed[:, -1] > 0, found, np.nan)

    return Statistic(of, drawn)


def area(upper: str, lower: str) -> Statistic:
    """Return the area under the ROC curve, %: the share of pairs in which the value of `upper` is larger.

    Args:
        upper: Metric, such as the probability of samples that are labelled slip.
        lower: Metric, such as the probability of the other samples.
    """

    def of(group: Recordings) -> float:
        from scipy.stats import rankdata

        (_, high), (_, low) = group.values(upper), group.values(lower)
        if not len(high) or not len(low):
            return np.nan
        ranks = rankdata(np.concatenate([high, low]))[: len(high)]
        return 100 * float((ranks.sum() / len(high) - (len(high) + 1) / 2) / len(low))

    return Statistic(of)


def ratio(part: Values, whole: Values) -> Values:
    """Return the quotient of arrays; NaN where the divisor is 0.

    >>> ratio(np.array([1.0, 1.0]), np.array([4.0, 0.0]))
    array([0.25,  nan])
    """
    part, whole = np.broadcast_arrays(np.asarray(part, np.float64), np.asarray(whole, np.float64))
    found: Values = np.divide(part, whole, out=np.full(part.shape, np.nan), where=whole > 0)
    return found


def estimates(
    results: pl.DataFrame,
    statistics: Mapping[str, Statistic],
    by: Sequence[str] = ("method",),
    *,
    draws: int = DRAWS,
) -> pl.DataFrame:
    """Compute statistics of each group of results, with their 95 % intervals over recordings.

    Args:
        results: Long table with the columns `COLUMNS`.
        statistics: Statistics by name.
        by: Columns that make the groups.
        draws: Number of draws of as many recordings, with replacement; 0: no intervals.

    Returns:
        A row for each group and statistic: the columns of `by`, ``statistic``, ``value``, ``low`` and
        ``high``; null if unknown. Fewer than three recordings have no interval.
    """
    found = list[dict[str, object]]()
    for key, part in results.group_by(by, maintain_order=True):
        group = Recordings(part)
        recordings = len(group.names)
        drawn, shares = draws if recordings >= _LEAST else 0, np.full(recordings, 1 / recordings)
        weights = np.random.default_rng(0).multinomial(recordings, shares, drawn).astype(np.float64)
        for name, statistic in statistics.items():
            values = statistic.drawn(group, weights) if statistic.drawn else np.empty(0)
            known = values[np.isfinite(values)]
            low, high = np.quantile(known, _TAILS).tolist() if len(known) else (None, None)
            value = statistic.of(group)
            row = {"statistic": name, "value": value, "low": low, "high": high}
            found.append({**dict(zip(by, key, strict=True)), **row})
    types: dict[str, type[pl.DataType]] = dict.fromkeys((*by, "statistic"), pl.String)
    types |= dict.fromkeys(("value", "low", "high"), pl.Float64)
    return pl.DataFrame(found, types).fill_nan(None)


def estimate_table(
    found: pl.DataFrame,
    decimals: Mapping[str, int | None],
    *,
    index: Sequence[str] = ("method",),
    columns: str = "statistic",
    intervals: Sequence[str] = (),
    caption: str = "",
) -> Table:
    """Return estimates as a table of a report.

    Args:
        found: Rows that `estimates` returned.
        decimals: Decimals by column.
        index: Columns that name a row.
        columns: Column whose values become the columns of the table.
        intervals: Those that are followed by a column with their interval.
        caption: Text above the table.
    """
    heads = found[columns].unique(maintain_order=True).to_list()
    rows: dict[tuple[str, ...], dict[str, tuple[float, str]]] = {}
    for row in found.iter_rows(named=True):
        digits = decimals.get(row[columns], 1) or 0
        text = "" if row["low"] is None else f"{row['low']:.{digits}f} to {row['high']:.{digits}f}"
        rows.setdefault(tuple(row[name] for name in index), {})[row[columns]] = row["value"], text
    names = [name for head in heads for name in ([head, INTERVAL] if head in intervals else [head])]
    cells: list[list[Value]] = []
    for key, values in rows.items():
        cells.append(list(key))
        for head in heads:
            value, text = values.get(head, (None, ""))
            cells[-1] += [value, text or None] if head in intervals else [value]
    return Table([*index, *names], cells, caption, dict(decimals))
