from importlib import import_module
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.measures import (
    AGAINST_SLIDING,
    BALANCED,
    EVENTS,
    SAMPLES,
    SHARES,
    accuracy,
    balanced,
    confusion,
    f1,
    judged,
    precision,
)
from flows.report.results import estimates, joined
from flows.report.results import median as median_of
from operators import Debounce
from operators.batch import Codes, Reals
from tests.flows.learn.conftest import TWICE, label


def recorded(codes: Codes, sliding: Codes | None = None, name: str = "one") -> LabelledRecording:
    return LabelledRecording(np.zeros((len(codes), 6), np.int16), codes, sliding=sliding, name=name)


def sure(codes: Codes) -> Reals:
    return np.where(codes, 0.9, 0.1)


def statistics(recording: LabelledRecording, probability: Reals) -> dict[str, float | None]:
    every = {**SHARES, **SAMPLES, **EVENTS, **AGAINST_SLIDING}
    found = estimates(judged(recording, probability, TWICE, method="psd"), every)
    return dict(found.select("statistic", "value").rows())


def test_both_targets_and_the_lead_are_measured() -> None:
    by_speed, by_sliding = label(1200, (204, 250), (404, 450)), label(1200, (200, 250), (400, 450))
    found = statistics(recorded(by_speed, by_sliding), sure(by_sliding))
    assert (found["delay ms"], found["sliding: delay ms"], found["lead ms"]) == (-30, 10, 30)
    assert found["sliding: balanced %"] == 100
    assert (found["balanced %"] or 0) < 100
    unknown = statistics(recorded(by_speed), sure(by_sliding))
    assert unknown["sliding: balanced %"] is unknown["sliding: missed %"] is None


def test_the_lead_is_the_time_from_the_first_onset_to_the_change_of_the_label() -> None:
    true = label(1200, (200, 250), (400, 450), (600, 650), (800, 850))
    raised = label(1200, (189, 195), (384, 390), (604, 610), (779, 785))  # one sample before each onset
    results = judged(recorded(true), sure(raised), TWICE, method="psd")
    [lead] = estimates(results, {"lead": median_of("lead ms")})["value"]
    assert lead == 100  # of 100 and 150 ms before and 50 ms late; the last is too early


def test_samples_without_a_label_or_an_answer_do_not_count() -> None:
    codes = np.repeat([0, 1, -1], 200).astype(np.int8)
    probability: Reals = np.where(np.arange(600) < 150, np.nan, 0.9)
    results = judged(recorded(codes), probability, Debounce(), method="psd")
    sums = {name: float(part["value"].sum()) for (name,), part in results.group_by("metric")}
    assert (sums["static as slip"], sums["slip as slip"], sums["slip as static"]) == (50, 200, 0)
    assert sums["events"] == 1
    assert sums["minutes"] == pytest.approx(5.01 / 60)
    far = sum(place // 10 not in (19, 20, 39) for place in range(150, 400))
    assert sums["far: static as slip"] + sums["far: slip as slip"] == far


def test_the_calibration_error_is_that_of_all_samples_together() -> None:
    def constant(slips: int) -> LabelledRecording:
        codes = np.zeros(599, np.int8)
        codes[99 : 99 + slips] = 1
        return recorded(codes, name=str(slips))

    recordings = [constant(slips) for slips in (50, 100, 150, 200, 250)]  # 10 to 50 % slip
    results = joined(judged(each, np.full(599, 0.3), TWICE, method="psd") for each in recordings)
    [found] = estimates(results, {"error": SAMPLES["calibration error %"]}).rows(named=True)
    assert found["value"] == pytest.approx(0)
    assert 0 < found["high"] < 20  # draws of recordings have other shares of slip


def test_a_recording_without_static_or_slip_has_no_balanced_accuracy() -> None:
    results = judged(recorded(label(300)), np.full(300, 0.1), TWICE, method="psd")
    found = estimates(results, {**BALANCED, **EVENTS}).select("statistic", "value").rows()
    assert dict(found) == {
        "balanced %": None,
        "events/min": 0,
        "false/min": 0,
        "missed %": None,
        "delay ms": None,
    }


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=2, max_size=60))
def test_scores_of_counts_are_those_of_the_samples(pairs: list[tuple[bool, bool]]) -> None:
    predicted, truth = np.array(pairs).T
    metrics: Any = import_module("sklearn.metrics")
    found = confusion(predicted, truth)
    expected = metrics.precision_recall_fscore_support(truth, predicted, average="weighted", zero_division=0)
    assert (precision(found), accuracy(found), f1(found)) == pytest.approx(100 * np.array(expected[:3]))
    assert accuracy(found) == pytest.approx(100 * metrics.accuracy_score(truth, predicted))
    if truth.any() and not truth.all():
        assert balanced(found) == pytest.approx(100 * metrics.balanced_accuracy_score(truth, predicted))
