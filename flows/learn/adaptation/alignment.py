"""Alignment of a TCN with other data: time scale and gain, folded into its weights.

A network that learned strokes of 0.5 s recognises strokes of 1 s if all dilations double: its receptive field
then covers twice the time, at the same cost per sample. Counts that are half as large are recognised if both
scales of its features halve. Neither changes the number of weights, and the result is a normal `Tcn`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from flows.learn.adaptation.segmentation import two_states
from flows.learn.training.recipe import LONGEST
from operators.batch import Counts, Reals
from operators.detectors import Tcn

TIME_SCALES: Final = (1, 2, 3)
GAINS: Final = (0.25, 1.0, 4.0)
LARGEST: Final = 8.0  # size of a logit beyond which it says no more


@dataclass(frozen=True, slots=True)
class Alignment:
    """Time scale and gain of other data, relative to the data that a network was trained on."""

    time_scale: int = 1  # duration of strokes; dilations are multiplied by it
    gain: float = 1.0  # counts are multiplied by it


def aligned(tcn: Tcn, alignment: Alignment) -> Tcn:
    """Return the network for data with another time scale and gain, for the same fingertip.

    >>> from storage import load_detector
    >>> aligned(load_detector("tcn"), Alignment(time_scale=2)).length
    198
    """
    weights = dict(tcn.weights)
    weights["dilations"] = weights["dilations"] * alignment.time_scale
    for name in ("position_scale", "step_scale"):
        weights[name] = (weights[name] / alignment.gain).astype(np.float32)
    result = type(tcn)(weights)
    result.fingertip = tcn.fingertip
    return result


def time_scales(tcn: Tcn) -> list[int]:
    """Return the time scales at which the window of a network is not too long; 1 at least."""
    return [each for each in TIME_SCALES if each == 1 or aligned(tcn, Alignment(each)).length <= LONGEST]


def best_alignment(tcn: Tcn, recordings: Sequence[tuple[Counts, Reals]]) -> Alignment:
    """Return the alignment at which the logit agrees best with a target.

    The measure is the correlation, plus the share of the variance of the sum of both, standardised, that is
    between the two states of the sum. All alignments are judged on the same samples.

    Args:
        tcn: Network to align.
        recordings: Counts (n, cells) and target (n,) of each; NaN: unknown.
    """
    candidates = [Alignment(scale, gain) for scale in time_scales(tcn) for gain in GAINS]
    start = aligned(tcn, candidates[-1]).length - 1
    target = np.concatenate([target[start:] for _, target in recordings])
    known = np.isfinite(target)
    wanted = standardised(target[known])
    found = list[float]()
    for candidate in candidates:
        network = aligned(tcn, candidate)
        logit = np.concatenate([logits(network, counts)[start:] for counts, _ in recordings])
        found.append(_unison(standardised(np.clip(logit, -LARGEST, LARGEST)[known]), wanted))
    return candidates[int(np.argmax(found))]


def standardised(values: Reals) -> Reals:
    """Return values (n,) with mean 0 and variance 1, or all 0 if they are equal."""
    centred: Reals = values - values.mean()
    return centred / (centred.std() or 1.0)


def _unison(logit: Reals, target: Reals) -> float:
    """Return how well a standardised logit (n,) agrees with a standardised target (n,)."""
    together = logit + target
    return float((logit * target).mean()) + two_states(together)[1]


def logits(tcn: Tcn, counts: Counts) -> Reals:
    """Return the logit of slip at each sample of counts (n, cells); (n,), NaN before the first window."""
    result = np.full(len(counts), np.nan)
    probability = tcn.stream().push(counts[:, None])[tcn.length - 1 :, 0]
    with np.errstate(divide="ignore"):
        result[tcn.length - 1 :] = np.log(probability) - np.log1p(-probability)
    return result
