"""What the trials of one method come to: medians, shares of trials, and how they failed."""

from collections import Counter
from collections.abc import Sequence
from math import isnan, nan

import numpy as np

from flows.cli.options import counted
from flows.lab.experiments.experiment import Found
from flows.lab.experiments.lifting import Lifting
from flows.lab.experiments.tapping import Tapping


def numbers(of: Found, method: str) -> dict[str, float]:
    """The measures of all trials of a method, by name.

    Returns:
        Of lifts: medians of the slide (mm; its 0.9 quantile too), of the delay (ms) and of the forces over
        the least that holds. Of taps: medians of slide and delay, and the shares of trials with a false slip
        (%). NaN where no trial has the number.
    """
    outcomes = of.all(method)
    lifts = [each for each in outcomes if isinstance(each, Lifting)]
    taps = [each for each in outcomes if isinstance(each, Tapping)]
    if lifts:
        return {
            "slide_mm": median([each.slide for each in lifts]),
            "slide_p90_mm": float(np.quantile([each.slide for each in lifts], 0.9)),
            "delay_ms": median([each.delay for each in lifts]),
            "force_ratio": median([each.ratio for each in lifts]),
            "peak_ratio": median([each.peak for each in lifts]),
        }
    return {
        "slide_mm": median([each.slide for each in taps]),
        "delay_ms": median([each.delay for each in taps]),
        "false_lift": 100 * float(np.mean([each.false_lift > 0 for each in taps])),
        "false_tap": 100 * float(np.mean([each.false_tap > 0 for each in taps])),
    }


def median(values: Sequence[float]) -> float:
    """The median of the values that are not NaN; NaN if all are.

    >>> median([1.0, nan, 2.0])
    1.5
    """
    present = [each for each in values if not isnan(each)]
    return float(np.median(present)) if present else nan


def failures(of: Found, method: str, things: Sequence[str]) -> dict[str, int]:
    """How many trials with some objects failed, by their ending."""
    return dict(
        Counter(each.ending for thing in things for each in of.outcomes[method, thing] if not each.success)
    )


def tried(of: Found) -> str:
    """How many trials a share is of, in words."""
    return f"{counted(of.trials, 'trial')} of each object"
