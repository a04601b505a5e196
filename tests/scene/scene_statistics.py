"""Statistics of the signal, their published values for real recordings, and the distance between them.

The published figures are those of "Under Pressure" (2021) and of its authors' public code, logs and plots.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from flows.learn.event_metrics import runs
from flows.learn.labelled_recordings import LabelledRecording
from operators import Zero
from operators.batch import BAROMETERS, Flags, Reals

RATE: Final = 100.0  # Hz
FREQUENCIES: Final = (2.0, 5.0, 10.0, 20.0)  # Hz
_ZEROING: Final = Zero().scans  # samples at the start that determine the baseline
_LOADED: Final = 20  # counts from zero


@dataclass(frozen=True, slots=True)
class Published:
    """One row of the comparison."""

    key: str
    text: str
    low: tuple[float, ...] = ()  # of the published range, per value; empty: not published
    high: tuple[float, ...] = ()  # if empty, the range is one number
    scale: tuple[float, ...] = ()  # unit of the distance; if empty, the middle of the range

    def distance(self, values: Reals) -> float:
        """Return the mean distance of the values from the published range, in units of its scale."""
        low = np.array(self.low)
        high = np.array(self.high or self.low)
        scale = np.array(self.scale) if self.scale else (np.abs(low) + np.abs(high)) / 2
        return float((np.maximum(np.maximum(low - values, values - high), 0) / scale).mean())


_STD = (182.7, 146.5, 80.1, 87.0, 140.5, 143.6)
_PLANE = (159.0, 145.0, 20.0, 3.0, 22.0, 109.0)
_SPHERE = (62.0, 168.0, 103.0, 94.0, 155.0, 75.0)

TABLE: Final = (
    Published("mean", "mean, counts", (-120.2, -59.3, -14.3, -19.8, -55.3, -60.1), scale=_STD),
    Published("std", "standard deviation, counts", _STD),
    Published("min", "least, counts", (-491, -497, -450, -502, -484, -475), scale=_STD),
    Published("max", "largest, counts", (190, 205, 200, 86, 163, 172), scale=_STD),
    Published("plane mean", "mean on the plane, counts", (-312, -132, -1, 2, -4, -92), scale=_STD),
    Published("plane std", "standard deviation on the plane, counts", _PLANE, scale=_STD),
    Published("sphere mean", "mean on the sphere, counts", (-7, -66, -17, -16, -73, -7), scale=_STD),
    Published("sphere std", "standard deviation on the sphere, counts", _SPHERE, scale=_STD),
    Published("slip rms", "one-step RMS of loaded barometers in slip, counts", (25,), (50,)),
    Published("static rms", "the same in static", (6,), (15,)),
    Published("slip step", "median step norm over the barometers in slip, counts", (31,), (46,)),
    Published("static step", "the same in static", (7,), (8.4,)),
    Published("quiet", "slip samples quieter than the static median, %", (4,), (12,)),
    Published("change", "largest change in 10, 30, 100 ms, counts", (212, 458, 501)),
    Published("static std", "standard deviation of loaded barometers, 0.4 s of static, counts", (4,), (10,)),
    Published("ratio 0.2 s", "slip/static ratio of the DFT at 5 to 50 Hz, 0.2-s windows", (2.5,), (4.6,)),
    Published("ratio 1 s", "the same, 1-s windows", (1.3,), (2.0,)),
    Published("rise", "signal rises after the label's onset by, ms (median)", (-20,), (20,)),
    Published("ring", "signal rings after the label's end for, ms (median)", (0,), (150,)),
    Published("slip spectrum", "amplitude in slip at 2, 5, 10, 20 Hz, counts"),
)  # fmt: skip


def measure(recordings: Sequence[LabelledRecording]) -> dict[str, Reals]:
    """Return the values of each row of `TABLE` for which there is data."""
    used = [
        (recording.counts[_ZEROING:].astype(np.float64), recording.slip[_ZEROING:])
        for recording in recordings
    ]
    counts = np.concatenate([z for z, _ in used])  # (n, 6)
    slip = np.concatenate([label[1:] for _, label in used])  # (m,) of the steps
    steps = np.concatenate([np.diff(z, axis=0) for z, _ in used])  # (m, 6)
    loaded = np.concatenate([np.abs(z[1:]) > _LOADED for z, _ in used])  # (m, 6)
    norm = np.sqrt(np.square(steps).sum(axis=1))  # (m,)
    calm, lively = float(np.median(norm[~slip])), float(np.median(norm[slip]))
    found = {
        "mean": counts.mean(axis=0),
        "std": counts.std(axis=0),
        "min": counts.min(axis=0),
        "max": counts.max(axis=0),
        "slip rms": _rms(steps, loaded & slip[:, None]),
        "static rms": _rms(steps, loaded & ~slip[:, None]),
        "slip step": np.array([lively]),
        "static step": np.array([calm]),
        "quiet": np.array([100 * (norm[slip] < calm).mean()]),
        "change": np.array([_change(used, lag) for lag in (1, 3, 10)]),
        "static std": _static_std(used),
        "ratio 0.2 s": _ratio(used, 20),
        "ratio 1 s": _ratio(used, 100),
        "slip spectrum": _spectrum(used),
    }
    rises, rings = edges(recordings)
    found["rise"], found["ring"] = _median(rises), _median(rings)
    for surface in ("plane", "sphere"):
        if these := [
            z
            for recording, (z, _) in zip(recordings, used, strict=True)
            if recording.strokes and recording.strokes.surface == surface
        ]:
            joined = np.concatenate(these)
            found[f"{surface} mean"], found[f"{surface} std"] = joined.mean(axis=0), joined.std(axis=0)
    return found


def edges(recordings: Sequence[LabelledRecording]) -> tuple[Reals, Reals]:
    """Return how long the signal rises after a label's onset and rings after its end, ms: (onsets,), (ends,).

    The signal is the RMS over 30 ms of the step norm. It is up above the geometric mean of its medians in
    slip and in static, and has ended when it stays down for 50 ms or the next slip begins. Onsets are left
    out if the signal is already up 150 ms before.
    """
    rises, rings = list[int](), list[int]()
    before, after, calm = 15, 30, np.ones(5)  # samples
    for recording in recordings:
        if recording.slip.all() or not recording.slip.any():
            continue
        steps = np.diff(recording.counts.astype(np.float64), axis=0, prepend=recording.counts[:1])
        level = np.sqrt(
            np.convolve(np.square(steps).sum(axis=1), np.full(3, 1 / 3))[: len(recording)]
        )  # (n,)
        up = level > np.sqrt(np.median(level[recording.slip]) * np.median(level[~recording.slip]))
        down = np.convolve(~up, calm)[len(calm) - 1 :] == len(calm)  # (n,) from here on
        for start, end in runs(recording.slip).tolist():
            around = up[max(start - before, 0) : start + after]
            if start >= before and around.any() and not around[:3].any():
                rises.append(int(np.argmax(around)) - before)
            if end + after <= len(recording):
                rings.append(int(np.argmax(down[end:] | recording.slip[end:])))
    return np.array(rises) * 1000 / RATE, np.array(rings) * 1000 / RATE


def _median(values: Reals) -> Reals:
    return np.array([np.median(values) if len(values) else np.nan])


def _rms(steps: Reals, chosen: Flags) -> Reals:
    """Return the root mean square of the chosen steps of each barometer, averaged over barometers; (1,)."""
    square = np.where(chosen, np.square(steps), 0).sum(axis=0)
    number = chosen.sum(axis=0)
    values = np.sqrt(square[number > 0] / number[number > 0])
    return np.array([values.mean() if values.size else np.nan])


Used = Sequence[tuple[Reals, Flags]]  # counts (n, 6) and whether each sample is slip


def _cut(used: Used, length: int, hop: int) -> tuple[Reals, Flags, Reals]:
    """Return windows (k, length, 6); True if their newest sample is slip; and their share of slip."""
    z = [sliding_window_view(counts, length, axis=0)[::hop] for counts, _ in used if len(counts) >= length]
    slip = [sliding_window_view(label, length)[::hop] for _, label in used if len(label) >= length]
    if not z:
        return np.empty((0, length, BAROMETERS)), np.empty(0, np.bool_), np.empty(0)
    joined = np.concatenate(slip)
    return np.concatenate(z).transpose(0, 2, 1), joined[:, -1], joined.mean(axis=1)


def _change(used: Used, lag: int) -> float:
    return max(float(np.abs(z[lag:] - z[:-lag]).max()) for z, _ in used)


def _static_std(used: Used) -> Reals:
    windows, _, share = _cut(used, 40, 10)
    still = windows[share == 0]  # (k, 40, 6)
    spread, loaded = still.std(axis=1), np.abs(still.mean(axis=1)) > _LOADED  # (k, 6)
    return np.array([np.median(spread[loaded]) if loaded.any() else np.nan])


def _ratio(used: Used, length: int) -> Reals:
    """Return the ratio of windows that end in slip to the others, over the loaded barometers; (1,)."""
    windows, slip, _ = _cut(used, length, 10)
    loaded = np.abs(windows.mean(axis=1)) > _LOADED  # (k, 6)
    frequency = np.fft.rfftfreq(length, 1 / RATE)
    size = np.abs(np.fft.rfft(windows, axis=1)[:, frequency >= FREQUENCIES[1]]).mean(axis=1)  # (k, 6)
    moving, still = loaded & slip[:, None], loaded & ~slip[:, None]
    if not moving.any() or not still.any():
        return np.array([np.nan])
    return np.array([size[moving].mean() / size[still].mean()])


def _spectrum(used: Used) -> Reals:
    """Return the mean amplitude (counts) at `FREQUENCIES`: loaded barometers, 0.4-s windows of slip."""
    length = 40
    windows, _, share = _cut(used, length, 10)
    chosen = windows[share == 1]  # (k, 40, 6)
    loaded = np.abs(chosen.mean(axis=1)) > _LOADED  # (k, 6)
    if not loaded.any():
        return np.full(len(FREQUENCIES), np.nan)
    weight = np.hanning(length + 2)[1:-1]
    wave = np.exp(-2j * np.pi * np.outer(FREQUENCIES, np.arange(length)) / RATE) * weight * 2 / weight.sum()
    centred = chosen - chosen.mean(axis=1, keepdims=True)
    size = np.abs(np.einsum("ft,ktc->fkc", wave, centred))  # (4, k, 6)
    spectrum: Reals = size[:, loaded].mean(axis=1)
    return spectrum
