"""Export of a span of a recorded session: the same values as the session has."""

import asyncio
import io
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from connectors.web.session_export import export_mcap, export_table
from connectors.web.session_page import SessionCurves
from connectors.web.session_requests import SessionPage
from flows.cli.show import load
from operators import InputError
from operators.batch import Touch, concat, ms, s
from storage import HandLabels, LabelSpan, Session
from tests.connectors.web.browsing import shaking
from tests.storage.made import record

START = 1_700_000_000 * s


@pytest.fixture
def session(tmp_path: Path) -> Session:
    """Return a session of 6 s of touch of two fingertips."""
    touch = concat(Touch, shaking(6))
    time, values = touch.time + START, (touch.counts, touch.temperature, touch.valid)
    dead = touch.valid.copy()
    dead[:, 2] = False
    both = [Touch(time, *values, finger=0), Touch(time, *values[:2], dead, finger=1)]
    return record(tmp_path, both)


@pytest.fixture
def page(session: Session) -> SessionPage:
    return asyncio.run(load(session, "psd"))


def test_a_table_has_the_rows_of_the_span_with_scores_and_labels(session: Session, page: SessionPage) -> None:
    session.write_hand_labels([LabelSpan(START + 4 * s, START + 5 * s, 1, "slip")], based_on=0)
    span = START + 3500 * ms, START + 4500 * ms
    content = export_table(page.curves, page.bands, session.hand_labels(), span, "parquet")
    table = pl.read_parquet(io.BytesIO(content))
    assert table.columns == [
        "time",
        "finger",
        *(f"p{k}" for k in range(6)),
        "probability",
        "speed",
        "arm",
        "truth",
        "hand",
    ]
    for finger in (0, 1):
        rows = table.filter(pl.col("finger") == finger)
        assert (rows["time"].min(), rows["time"].max(), len(rows)) == (*span, 101)
        stored = session.frame("touch").filter(
            (pl.col("finger") == finger) & pl.col("time").is_between(*span)
        )
        baseline = stored["counts"].arr.get(0).cast(pl.Float32) - rows["p0"]
        assert baseline.n_unique() == 1
    marked = table.filter(pl.col("hand") == 1)
    assert (marked["finger"].unique().to_list(), len(marked)) == ([1], 51)
    assert table.filter(pl.col("finger") == 1)["p2"].null_count() == 101
    time, probability = page.curves.curves["scores", "0"]
    row = int(np.searchsorted(time, span[1]))
    assert table.filter(pl.col("finger") == 0)["probability"][-1] == probability[row]
    assert set(table["arm"]) == set(table["truth"]) == {-1}


def test_csv_and_parquet_have_the_same_table(session: Session, page: SessionPage) -> None:
    span = START + 5 * s, START + 6 * s
    first, second = (
        export_table(page.curves, page.bands, session.hand_labels(), span, kind)
        for kind in ("csv", "parquet")
    )
    csv, parquet = pl.read_csv(first), pl.read_parquet(second)
    assert csv["time"].to_list() == parquet["time"].to_list()
    assert csv["p3"].to_list() == parquet["p3"].to_list()
    assert csv["probability"].to_list() == parquet["probability"].to_list()


def test_fingertips_of_different_sizes_share_a_table() -> None:
    curves = SessionCurves()
    for finger, cells in ((0, 2), (1, 3)):
        counts = np.full((1, cells), 7, np.int16)
        curves.take(Touch(np.array([START]), counts, counts, counts > 0, finger=finger))
    asyncio.run(curves.close())
    table = pl.read_csv(export_table(curves, None, HandLabels(), (START, START), "csv"))
    assert table.select("finger", "p0", "p1", "p2").rows() == [(0, 7.0, 7.0, None), (1, 7.0, 7.0, 7.0)]
    assert table.columns[2:6] == ["p0", "p1", "p2", "probability"]


def test_a_span_without_rows_is_an_error(session: Session, page: SessionPage) -> None:
    with pytest.raises(InputError, match="has 0 rows in this span, must have 1 to 1,000,000: zoom in or out"):
        export_table(page.curves, page.bands, session.hand_labels(), (0, 1), "csv")


def test_an_mcap_file_has_all_rows_of_the_span(session: Session) -> None:
    pytest.importorskip("mcap", reason="needs the extra `mcap`")
    from mcap.reader import make_reader  # noqa: PLC0415 - an extra

    span = START + 1 * s, START + 2 * s
    found = [
        (channel.topic, message.log_time)
        for _, channel, message in make_reader(io.BytesIO(export_mcap(session, span))).iter_messages()
    ]
    assert {topic for topic, _ in found} == {"/touch/0", "/touch/1"}
    assert (min(time for _, time in found), max(time for _, time in found), len(found)) == (*span, 202)
