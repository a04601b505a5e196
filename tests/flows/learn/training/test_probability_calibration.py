from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit, logit

from flows.learn.labelled_recordings import by_split, load
from flows.learn.training.trainer import Calibration, calibration_of
from operators.detectors import FrequencyCnn, PaperTcn, Tcn
from storage import load_detector
from storage.models import load_card, read_weights, shipped
from tests.flows.learn.conftest import Trained


@given(st.floats(0.3, 3), st.floats(-2, 2), st.integers(0, 99))
def test_a_known_temperature_and_bias_are_found_again(temperature: float, bias: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    logits = rng.normal(0, 2, 20_000)
    probability = expit(logits / temperature + bias)
    found = Calibration.fitted(expit(logits), rng.random(logits.size) < probability)
    inputs = np.stack((logits, np.ones_like(logits)))  # (2, n)
    information = inputs * probability * (1 - probability) @ inputs.T  # Fisher's, of 1 / temperature and bias
    slope_error, bias_error = np.sqrt(np.diag(np.linalg.inv(information)))  # standard errors
    assert 1 / found.temperature == pytest.approx(1 / temperature, abs=5 * slope_error)
    assert found.bias == pytest.approx(bias, abs=5 * bias_error)


@pytest.mark.parametrize(
    ("name", "kind"), [("tcn", Tcn), ("paper_tcn", PaperTcn), ("frequency_cnn", FrequencyCnn)]
)
def test_folded_weights_give_the_calibrated_probability(name: str, kind: type[Tcn]) -> None:
    path = shipped(name)
    assert path is not None
    weights, _ = read_weights(path, path.read_bytes())
    calibration = Calibration(1.7, -0.4)
    before, after = kind(weights), kind(calibration.fold(weights))
    windows = np.random.default_rng(0).normal(0, 30, (50, before.length, 6)).round().astype(np.int16)
    expected = expit(logit(before.score(windows)) / 1.7 - 0.4)
    np.testing.assert_allclose(after.score(windows), expected, atol=1e-5)
    assert np.ptp(expected) > 0.001


@pytest.mark.parametrize("slip", [[True, True], [False, False]])
def test_one_class_alone_changes_nothing(slip: list[bool]) -> None:
    assert Calibration.fitted(np.array([0.2, 0.8]), np.array(slip)) == Calibration(1, 0)


@pytest.mark.parametrize("slip", [[False, True], [True, False]])
def test_separated_and_contradicting_data_give_a_positive_finite_temperature(slip: list[bool]) -> None:
    found = Calibration.fitted(np.array([0.2, 0.8]), np.array(slip))
    assert 0 < found.temperature <= 100
    assert np.isfinite(found.bias)


def test_the_card_states_the_calibration_that_the_weights_contain(small: Trained, tiny: Path) -> None:
    out = small.model.path
    assert load_card(out)["calibration"]["temperature"] != 1
    again = calibration_of(load_detector(out), by_split(load(tiny))["validation"])
    assert again.temperature == pytest.approx(1, abs=0.02)
    assert again.bias == pytest.approx(0, abs=0.02)
