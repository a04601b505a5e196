"""Models with debounce settings that keep a stated rate of false alarms with a stated confidence."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise, starmap, takewhile
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, gammainccinv, ndtri, stdtrit

from flows.learn.event_metrics import EventMetrics, TrueSlips, debounce_settings
from flows.learn.labelled_recordings import LabelledRecording, load
from flows.learn.training.trained_model import learned, provenance, repeated
from flows.report.table import counted, show
from operators import Debounce
from operators.batch import Reals
from operators.errors import InputError, SlipflowError
from operators.extras import software_version
from storage import files, load_detector
from storage.models import ALARMS, LIMIT, alarm_entries, load_card, save_card, shipped

_MISSED: Final = 1000.0  # ms, delay that a missed slip counts as in the choice among settings that hold
_PIECES: Final = 10  # into which a single session is cut


def _path() -> tuple[Debounce, ...]:
    logits = np.arange(7, -1.6, -0.25)  # of the thresholds
    thresholds = np.round(expit(logits), 5).tolist()
    rules = [Debounce(thresholds[0], run, 12) for run in (50, 30, 20, 12, 8)]
    for logit, threshold in zip(logits, thresholds, strict=True):
        run = 5 if logit >= 5 else 3 if logit >= 4 else 2 if logit >= 3 else 1
        release = 12 if logit >= 1 else 8 if logit >= 0 else 5
        rules.append(Debounce(threshold, run, release))
    return tuple(rules)


PATH: Final = _path()  # at 100 Hz, from strict to sensitive; fixed before any data is seen


@dataclass(frozen=True, slots=True, eq=False)
class SettingTrials:
    """Outcome of every setting of `PATH` on every session, or on each piece of a single one."""

    outcomes: Sequence[Sequence[EventMetrics]]  # [setting][session]
    rules: Sequence[Debounce] = PATH  # the settings at the rate of the recordings

    @property
    def alarms(self) -> NDArray[np.int64]:
        """False alarms (settings, sessions)."""
        return np.array([[each.false_alarms for each in row] for row in self.outcomes], np.int64)

    @property
    def minutes(self) -> Reals:
        """Static minutes of each session; (sessions,)."""
        return np.array([each.minutes for each in self.outcomes[0]])


@dataclass(frozen=True, slots=True)
class Calibrated:
    """Setting that keeps a rate of false alarms."""

    rate: float  # false alarms per static minute
    confidence: float
    debounce: Debounce
    bound: float  # upper confidence limit of its rate, per static minute
    measured: EventMetrics  # on the calibration data

    def report(self, path: Path) -> str:
        """Return the result, which the card of the model at `path` has, as text."""
        rule, events, rate = self.debounce, self.measured, f"{self.rate:g}/min"
        slips = f"{events.missed:.1f} % of slips missed" if events.slips else "no slips"
        if len(events.delays):
            slips += f", median delay {np.median(events.delays):.0f} ms"
        return (
            f"threshold {rule.threshold:g}; {counted(rule.consecutive, 'decision')} to start,"
            f" {rule.release} to end: at most {self.bound:.2g} false alarms per static minute with"
            f" {100 * self.confidence:g} % confidence ({rate} wanted)\n"
            f"measured: {counted(events.false_alarms, 'false alarm')} in {events.minutes:.1f} static minutes;"
            f" {slips}\n"
            f"wrote {path} and its card; use it with"
            f" `slipflow run live --set detector={path} --set false_alarms={rate}`"
        )


def try_settings(recordings: Sequence[LabelledRecording], probabilities: Sequence[Reals]) -> SettingTrials:
    """Debounce the probabilities (n,) of recordings with every setting.

    The fingertips of one session are one recording: their alarms have common causes. A single session is cut
    into ten pieces.
    """
    pieces = _PIECES if len({each.session for each in recordings}) == 1 else 1
    parts = dict[tuple[tuple[str, str], int], tuple[list[Reals], list[TrueSlips]]]()
    for recording, probability in zip(recordings, probabilities, strict=True):
        edges = np.linspace(0, len(recording), pieces + 1).astype(int).tolist()
        for number, rows in enumerate(starmap(slice, pairwise(edges))):
            values, slips = parts.setdefault((recording.session, number), ([], []))
            values.append(probability[rows])
            slips.append(TrueSlips.labelled(recording.piece(rows)))
    rules = tuple(map(recordings[0].sampling.rule, PATH))
    return SettingTrials([[EventMetrics.of(*part, rule) for part in parts.values()] for rule in rules], rules)


def calibrated(trials: SettingTrials, rate: float, confidence: float) -> Calibrated:
    """Return the best setting whose rate of false alarms is at most `rate`, with a confidence.

    The hypotheses "this setting has a higher rate" are tested from the strictest setting to the most
    sensitive one, each at the full error probability, up to the first that is not rejected. The order is
    fixed beforehand, so the probability that any accepted setting exceeds the rate is at most
    1 - confidence: fixed-sequence testing, as in "Learn then Test" [1]. `alarm_limit` says what each test
    assumes.

    So any accepted setting may be chosen by its outcome on the same data: the one with the least mean delay,
    where a missed slip counts as one second; without slips the most sensitive one.

    Raises:
        TooLittleDataError: if not even the strictest setting is accepted.

    References:
        [1] Angelopoulos, Bates, Candes, Jordan and Lei, "Learn then Test: Calibrating Predictive Algorithms
        to Achieve Risk Control" (2021).
    """
    every, each_minutes = trials.alarms, trials.minutes
    minutes = float(each_minutes.sum())
    limits = (alarm_limit(alarms, each_minutes, confidence) for alarms in every)
    accepted = list(takewhile(lambda limit: limit <= rate * minutes, limits))
    if not accepted:
        needed = alarm_limit(every[0], each_minutes, confidence) / rate
        raise TooLittleDataError(rate, confidence, int(every[0].sum()), minutes, needed)
    found = [_sum(row) for row in trials.outcomes[: len(accepted)]]
    best = min(range(len(found)), key=lambda setting: (_cost(found[setting]), -setting))
    return Calibrated(rate, confidence, trials.rules[best], accepted[best] / minutes, found[best])


def _cost(found: EventMetrics) -> float:
    """Return the mean delay, ms, to whole ms; 0 without slips."""
    total = float(found.delays.sum()) + found.missed_slips * _MISSED
    return round(total / found.slips) if found.slips else 0.0


def _sum(every: Sequence[EventMetrics]) -> EventMetrics:
    return EventMetrics(
        np.concatenate([np.empty(0), *(each.delays for each in every)]),
        sum(each.missed_slips for each in every),
        sum(each.false_alarms for each in every),
        sum(each.repeats for each in every),
        sum(each.minutes for each in every),
    )


def alarm_limit(alarms: NDArray[np.int64], minutes: Reals, confidence: float) -> float:
    """Return the upper confidence limit of the expected number of false alarms in all these minutes.

    Alarms in one session resemble each other: a session of a rough surface has many. So sessions, or all
    sessions of a surface, are the exchangeable units, not samples. The limit is that of a Poisson count,
    after count and time have been divided by the design effect, the factor by which the variance over units
    exceeds that of a Poisson process [1]. The effect is at least 1, and enlarged by a quotient of quantiles
    of the t and the normal distribution because it is estimated from few units.

    Without clusters the limit is exact or conservative: for units that have at most one alarm each, with any
    probabilities, because such a sum is rarer far below its mean than a Poisson count [2]; and for Poisson
    counts. For clustered alarms it is an approximation. No limit can exclude a unit with very many alarms
    that none of the given ones resembles. Without any alarm it is -ln(1 - confidence): 3.0 at 95 %.

    Args:
        alarms: (n,) false alarms of each unit.
        minutes: (n,) static minutes of each unit.
        confidence: Probability that the expected number is at most the limit, above 0.5, below 1.

    >>> round(alarm_limit(np.zeros(5, np.int64), np.ones(5), 0.95), 3)
    2.996
    >>> round(alarm_limit(np.ones(5, np.int64), np.ones(5), 0.95), 2)
    10.51
    >>> round(alarm_limit(np.array([5, 0, 0, 0, 0]), np.ones(5), 0.95), 2)
    34.2

    References:
        [1] Korn and Graubard, "Confidence intervals for proportions with small expected number of positive
        counts estimated from survey data", Survey Methodology 24 (1998).
        [2] Hoeffding, "On the distribution of the number of successes in independent trials" (1956); Anderson
        and Samuels, "Some inequalities among binomial and Poisson probabilities" (1967).
    """
    count = int(alarms.sum())
    effect = _design_effect(alarms, minutes)
    if effect > 1:
        effect *= float(stdtrit(len(alarms) - 1, confidence) / ndtri(confidence)) ** 2
    return effect * float(gammainccinv(count / effect + 1, 1 - confidence))


def _design_effect(alarms: NDArray[np.int64], minutes: Reals) -> float:
    """Return the variance of the number of alarms over units relative to a Poisson count, at least 1."""
    count, size = int(alarms.sum()), len(alarms)
    if size < 2 or count < 2:
        return 1.0
    residuals = alarms - count * minutes / minutes.sum()
    return max(float((residuals**2).sum()) * size / (size - 1) / count, 1.0)


class TooLittleDataError(SlipflowError):
    """Too little static time to show that a rate of false alarms is kept, even by the strictest setting."""

    def __init__(self, rate: float, confidence: float, alarms: int, minutes: float, needed: float) -> None:
        had = f"{alarms} false alarm{'' if alarms == 1 else 's'}" if alarms else "no false alarm"
        found = f"the strictest setting had {had} in {show(minutes, None)} static minutes"
        if alarms > rate * minutes:
            advice = (
                f", {alarms / minutes:.2g} per minute, so more data will not help;"
                " allow a higher rate, or train the model for such recordings"
            )
        else:
            more = f"{show(needed - minutes, None)} more static minutes"
            more += " without a further one" if alarms else ""
            advice = f", but {show(needed, None)} are needed; record {more}, or allow a higher rate"
        super().__init__(
            f"a rate of {rate:g} false alarms per minute cannot be shown with {100 * confidence:g} %"
            f" confidence: {found}{advice}"
        )
        self.rate, self.confidence, self.alarms = rate, confidence, alarms
        self.minutes, self.needed = minutes, needed


def calibrate_model(
    model: str,
    paths: Sequence[Path],
    rate: float,
    confidence: float,
    log: Callable[[str], object] = lambda _: None,
) -> tuple[Path, Calibrated]:
    """Choose the debounce of a model for a rate of false alarms, and write it into the model's card.

    A shipped model is first copied into the current folder. Recordings that the model was trained or chosen
    on are left out. Settings for other rates are kept.

    Args:
        model: Name of a shipped model, or its file.
        paths: Labelled datasets or sessions.
        rate: False alarms per static minute.
        confidence: Probability that the rate is kept in recordings like these.
        log: Receives progress messages.

    Returns:
        File of the model, and the setting.

    Raises:
        InputError: if the model has no file, the recordings cannot be read, are all left out or repeat each
            other, or the copy of a shipped model exists.
        FingertipError: if the fingertip of the recordings differs from that of the model.
        TooLittleDataError: if there are too few static minutes.
        OSError: if the model cannot be written.
    """
    source = shipped(model) or Path(model)
    detector = load_detector(model)
    if source.suffix != ".safetensors":
        raise InputError(model, "has no weights, so it has no card to write settings into")
    path = Path(source.name) if shipped(model) else source
    if path != source and path.exists():
        raise InputError(str(path), "exists: calibrate it, or delete it")
    card = load_card(source)
    entries = alarm_entries(model, card)
    log(f"reading {', '.join(map(str, paths))}")
    recordings = load(*paths)
    if known := learned(card, recordings):
        log(f"left out {counted(len(known), 'recording')}: {model} has learned from them")
        recordings = [each for each in recordings if each not in known]
    if not recordings:
        raise InputError("calibrate", "no recordings are left: give some that the model has not learned from")
    if twice := repeated(recordings, [f"recording {number}" for number in range(1, len(recordings) + 1)]):
        raise InputError("calibrate", f"{twice[0]}: give each recording once")
    log(f"scoring {counted(len(recordings), 'recording')}")
    trials = try_settings(recordings, [one.probabilities(detector) for one in recordings])
    found = calibrated(trials, rate, confidence)
    entries[rate] = {
        "false_alarms_per_min": rate,
        "confidence": confidence,
        "bound_per_min": round(found.bound, 4),
        "debounce": debounce_settings(found.debounce),
        "static_minutes": round(found.measured.minutes, 3),
        "data": provenance(recordings),
        "software": f"slipflow {software_version()}",
    }
    if path != source:
        files.put(path, files.read(source, LIMIT))
    save_card(path, {**card, ALARMS: [entries[each] for each in sorted(entries)]})
    return path, found
