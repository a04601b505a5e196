"""Learning curve: the score on the validation split during training."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flows.report.figures import CELLS, INK, SOFT, Figure, grid, styled


@dataclass(frozen=True, slots=True)
class Check:
    """Evaluation on the validation split during training."""

    done: int  # steps
    seconds: float
    loss: float  # mean since the last check, nats
    accuracy: float  # on the validation split, %
    balanced: float  # the same, mean of the two classes, %


def best(curve: Sequence[Check]) -> Check:
    """Return the check with the best balanced accuracy, the first of equals.

    >>> best([Check(1, 2.0, 0.6, 70.0, 71.0), Check(2, 4.0, 0.5, 80.0, 79.0)]).done
    2
    """
    return max(curve, key=lambda check: check.balanced)


@styled
def draw(curves: Mapping[str, Sequence[Check]]) -> Figure:
    """Draw accuracy on the validation split over minutes of training, for each curve."""
    figure, (axes,) = grid(1, 1, (6.5, 3.2))
    ends = [best(curve) for curve in curves.values()]
    for color, (name, curve), end in zip(CELLS * len(curves), curves.items(), ends, strict=False):
        minutes = [check.seconds / 60 for check in curve]
        axes.plot(minutes, [check.accuracy for check in curve], color=color, label=name)
        axes.plot([end.seconds / 60], [end.accuracy], "o", color=color, markersize=4)
    longest = max(end.seconds for end in ends) / 60
    axes.set_title(f"The best check comes after {longest:.1f} minutes at most")
    axes.set_xlabel("minutes of training")
    axes.set_ylabel("accuracy on validation, %")
    axes.grid(axis="y")
    axes.legend(labelcolor=SOFT if len(curves) == 1 else INK)
    return figure
