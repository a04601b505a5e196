from pathlib import Path

import numpy as np
import pytest
from scipy.signal import periodogram

from operators import SLIP, STATIC, UNKNOWN, ParameterError
from operators.batch import Codes, Counts, Reals
from operators.detectors import Psd

TRACE = Path(__file__).parents[3].parent / "shared" / "real" / "mat_trace.csv"
SECONDS = np.arange(25) / 100


def _window(*channels: Reals) -> Reals:
    """One window whose first barometers read so, the rest 0."""
    window = np.zeros((1, len(channels[0]), 6))
    window[0, :, : len(channels)] = np.transpose(channels)
    return window


def real_windows(length: int) -> tuple[Counts, Codes]:
    """Return the windows of the real trace and the labels of their newest samples."""
    if not TRACE.exists():
        pytest.skip(f"no real trace at {TRACE}")
    table = np.genfromtxt(TRACE, delimiter=",", names=True)
    counts = np.stack([table[f"s{cell}"] for cell in range(1, 7)], axis=1).astype(np.int16)
    windows = np.lib.stride_tricks.sliding_window_view(counts, length, axis=0).swapaxes(1, 2)
    return windows, table["label"][length - 1 :].astype(np.int8)


def _accuracies(probability: Reals, labels: Codes) -> tuple[float, float]:
    right = (probability >= 0.5) == (labels == SLIP)
    balanced = (right[labels == SLIP].mean() + right[labels == STATIC].mean()) / 2
    return float(right.mean()), float(balanced)


@pytest.mark.parametrize(("length", "cutoff"), [(25, 10), (25, 0), (100, 30), (32, 12.5), (2, 0), (3, 20)])
def test_the_power_equals_scipys_periodogram(length: int, cutoff: float) -> None:
    window = np.random.default_rng(0).normal(size=(1, length, 6)) * 30 - 200
    weights = np.hanning(length + 2)[1:-1]
    weighted: Reals = (window[0] - window[0].mean(axis=0)) * weights[:, None]
    frequency, power = periodogram(weighted, 100, detrend=False, axis=0)
    expected = power[frequency > cutoff].sum() * 100 / (weights @ weights)
    assert Psd(length, cutoff).power(window).item() == pytest.approx(expected, rel=1e-9)


def test_the_probability_is_a_half_at_the_threshold_and_grows_with_the_power() -> None:
    window = _window(40 * np.sin(2 * np.pi * 24 * SECONDS))
    power = Psd().power(window).item()
    assert Psd(threshold=power).score(window).item() == 0.5
    assert Psd(threshold=power).score(2 * window).item() == 0.8
    assert Psd(threshold=power).score(0 * window).item() == 0


def test_fitted_takes_the_threshold_of_the_best_balanced_accuracy() -> None:
    wave = np.sin(2 * np.pi * 24 * SECONDS)
    windows = np.concatenate([_window(amplitude * wave) for amplitude in (1, 2, 9, 3, 8, 9, 100)])
    labels = np.array([STATIC, STATIC, STATIC, SLIP, SLIP, SLIP, UNKNOWN], np.int8)
    psd = Psd()
    assert psd.fitted(windows, labels).threshold == psd.power(windows)[3]
    with pytest.raises(ParameterError, match="labels"):
        psd.fitted(windows, np.zeros(7, np.int8))


def test_short_windows_separate_slip_from_static_on_the_realreal_windows() -> None:
    windows, labels = real_windows(25)
    assert _accuracies(Psd().score(windows), labels) == pytest.approx((0.796, 0.797), abs=1e-3)
    fitted = Psd().fitted(windows, labels)
    assert _accuracies(fitted.score(windows), labels)[1] == pytest.approx(0.806, abs=1e-3)
    windows, labels = real_windows(100)
    fitted = Psd(100).fitted(windows, labels)
    assert _accuracies(fitted.score(windows), labels)[1] < 0.55
