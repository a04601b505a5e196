"""The sections of an evaluation's page; each has a finding as its title, its tables, and a figure."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import isnan
from typing import Final

import numpy as np

from flows.learn.evaluation import evaluation_figures as figures
from flows.learn.evaluation.evaluation_study import Evaluation, Result
from flows.learn.evaluation.event_metrics import EventMetrics
from flows.learn.evaluation.label_changes import EDGES
from flows.learn.evaluation.motion_metrics import Cell, Cells
from flows.learn.evaluation.published import SURFACES, TABLE_1, TABLE_3, TABLE_3_ANY
from flows.learn.evaluation.sample_metrics import Confusion
from flows.report.page import NONE, Section, Table, drawn, number

# the row of Table I that each method stands beside
_PAPER_ROW: Final[Mapping[str, str]] = {
    "psd": "PSD threshold",
    "psd_1s": "PSD threshold",
    "frequency_cnn": "frequency CNN",
    "frequency_cnn_interleaved": "frequency CNN",
    "paper_tcn": "TCN",
    "tcn": "TCN",
}
NEAR: Final = 60  # ms
FAR: Final = 100  # ms


def sections(of: Evaluation) -> list[Section]:
    """The sections that have something to show."""
    made = [accuracy(of), confusions(of), curves(of), users(of), *motions(of), changes(of), *sliding(of)]
    return [section for section in made if section.tables]


def leader(of: Evaluation) -> Result:
    """The method that titles speak of: the default, or the most accurate."""
    for result in of.results:
        if result.method.name == "tcn":
            return result
    return max(of.results, key=lambda result: result.confusion.accuracy)


def accuracy(of: Evaluation) -> Section:
    """Table I."""
    first = leader(of)
    rows = [
        [
            result.method.name,
            *(number(value) for value in _table_1(result.confusion)),
            *(number(value) for value in paper_of(result.method.name)),
            number(result.confusion.balanced),
            result.method.origin,
        ]
        for result in of.results
    ]
    shares = ("accuracy", "precision", "recall", "F1")
    head = ["method", *shares, *(f"paper {name}" for name in shares), "balanced", "origin"]
    return Section(
        "accuracy",
        f"{first.method.name} is right on {first.confusion.accuracy:.1f} % of the samples; "
        f"the paper's TCN was on {TABLE_1['TCN'][0]} % of its real ones",
        f"The paper's Table I, in %: shares are weighted averages over the two classes, on every one of "
        f"{of.samples} samples of {of.recordings} recordings ({of.static:.0f} % static). The paper's figures "
        "are of its own, real test set."
        + "".join(f" Not judged: {name}, {reason}." for name, reason in of.missing.items()),
        [Table(head, rows)],
    )


def confusions(of: Evaluation) -> Section:
    """Which of the two is mistaken for the other."""
    first = leader(of)
    static, slip = first.confusion.recalls
    rows = [
        [result.method.name, *(f"{int(count)}" for count in result.confusion.counts.ravel())]
        + [number(share) for share in result.confusion.recalls]
        for result in of.results
    ]
    head = ["method", "static, right", "static called slip", "slip called static", "slip, right"]
    return Section(
        "confusion",
        f"{first.method.name} recognises {static:.1f} % of static and {slip:.1f} % of slip",
        "Samples by label and answer; shares are of each label.",
        [Table([*head, "static %", "slip %"], rows)],
        drawn(lambda: figures.confusions(of.results)),
    )


def curves(of: Evaluation) -> Section:
    """ROC and reliability."""
    first = leader(of)
    best = max(of.results, key=lambda result: result.roc.area)
    rows = [
        [result.method.name, number(100 * result.roc.area), number(result.reliability.error)]
        for result in of.results
    ]
    return Section(
        "curves",
        f"The area under the ROC of {best.method.name} is {100 * best.roc.area:.1f} %; "
        f"the probabilities of {first.method.name} are off by {first.reliability.error:.1f} % on average",
        "The expected calibration error is how far the share of slip lies from the probability, in ten bins, "
        "weighted by their samples.",
        [Table(["method", "area %", "calibration error %"], rows)],
        drawn(lambda: figures.curves(of.results)),
    )


def users(of: Evaluation) -> Section:
    """What users of slip events feel."""
    first = leader(of)
    events = first.events
    rows = [
        [
            result.method.name,
            *_event_cells(result.events),
            *_event_cells(result.paper_rule)[:3],
            f"{result.debounce.threshold:g} / {result.debounce.consecutive} / {result.debounce.release}",
            result.chosen,
        ]
        for result in of.results
    ]
    head = ["method", "false/min", "missed %", "delay ms", "90 % ms", "repeated %"]
    head += ["paper rule: false/min", "missed %", "delay ms", "threshold / on / off", "chosen on"]
    return Section(
        "users",
        f"{first.method.name} raises {events.false_alarms_per_min:.1f} false alarms per static minute, "
        + _missed(events),
        f"{events.slips} slips by the label in {events.minutes:.1f} static minutes. An onset from 50 ms "
        "before a slip to 150 ms after it answers it; others are false alarms. A slip needs an onset of its "
        "own. Repeated are onsets of a slip after its first, of all slips. Settings: the probability that "
        "is a slip decision, how many in a row begin a slip, how many static ones end it; where nothing "
        f"else is said, they are chosen on the validation split for at most {of.budget:g} false alarms per "
        "static minute, 2 % missed, and among these for the least delay. The paper's rule is 0.5 / 2 / 2.",
        [Table(head, rows)],
        drawn(lambda: figures.delays(of.results)),
    )


def motions(of: Evaluation) -> list[Section]:
    """Table III."""
    first = leader(of)
    if not first.cells.cells:
        return []
    paper = next((result for result in of.results if result.method.name == "paper_tcn"), None)
    shown = [first] if paper in (None, first) else [first, paper]
    order = [first, *(result for result in of.results if result is not first)]
    pairs = [
        (first.cells.at(Cell(kind, pace, surface)).f1, theirs)
        for (kind, pace), row in TABLE_3.items()
        for surface, theirs in zip(SURFACES, row, strict=False)
    ]
    known = [(ours, theirs) for ours, theirs in pairs if not isnan(ours)]
    reached = sum(ours >= theirs for ours, theirs in known)
    turned = first.cells.confusion(lambda cell: cell.kind == "rotation").f1
    return [
        Section(
            "motions",
            f"{first.method.name} is at or above the paper's F1 in {reached} of {len(known)} kinds of motion "
            f"and surface; rotation {number(turned)} %",
            "The paper's Table III: F1 weighted over the two classes, %, by motion and surface (cylinders by "
            "the axis that they are aligned with), the paper's figure in brackets.",
            [Table(*cells_table(result.cells), caption=result.method.name) for result in order],
            drawn(lambda: figures.motion({result.method.name: result.cells for result in shown})),
        )
    ]


def cells_table(cells: Cells) -> tuple[list[str], list[list[str]]]:
    """Head and rows of Table III for one method."""
    rows = list[list[str]]()
    for (kind, pace), paper in TABLE_3.items():
        found = [cells.at(Cell(kind, pace, surface)).f1 for surface in SURFACES]
        found.append(_of_motion(cells, kind, pace).f1)
        rows.append([motion_name(kind, pace), *map(_beside, found, paper)])
    every = [_on_surface(cells, surface).f1 for surface in SURFACES]
    rows.append(["any", *map(_beside, every, TABLE_3_ANY), number(cells.confusion().f1)])
    return ["motion", *(surface.replace("_", " ") for surface in SURFACES), "all"], rows


def motion_name(kind: str, speed: float | None) -> str:
    """A kind of motion as a person says it."""
    return "rotation" if speed is None else f"{kind}, {100 * speed:g} cm/s"


def changes(of: Evaluation) -> Section:
    """How the label's own uncertainty limits accuracy."""
    first = leader(of)
    spans = [*(f"{low}-{high - 10}" for low, high in pairwise(EDGES)), f"{EDGES[-1]} or more"]
    rows = [
        [span, f"{int(first.changes.samples[place])}"]
        + [number(float(result.changes.accuracy[place])) for result in of.results]
        for place, span in enumerate(spans)
    ]
    names = [result.method.name for result in of.results]
    return Section(
        "changes",
        f"{first.changes.near(NEAR):.0f} % of the errors of {first.method.name} lie within {NEAR} ms of a "
        f"change of the label; {FAR} ms or more from any it is right on {first.changes.far(FAR):.1f} %",
        "Accuracy, %, by how far the nearest change of the label is. The label is the arm's speed as it "
        "arrived; the contact begins and ends to slide up to 100 ms sooner or later.",
        [Table(["ms to the change", "samples", *names], rows)],
        drawn(lambda: figures.changes(of.results)),
    )


def sliding(of: Evaluation) -> list[Section]:
    """Held against what the contact truly did."""
    if of.label is None:
        return []
    first, rows = leader(of), [["the label itself", *map(number, _against(of.label)), *[NONE] * 4]]
    for result in of.results:
        assert result.sliding, "the truth is known for all methods or for none"
        assert result.sliding_events, "the same"
        rows.append(
            [
                result.method.name,
                *map(number, _against(result.sliding)),
                *_event_cells(result.sliding_events)[:4],
            ]
        )
    assert first.sliding, "as above"
    head = ["method", "accuracy", "balanced", "F1", "false/min", "missed %", "delay ms", "90 % ms"]
    return [
        Section(
            "sliding",
            f"The label itself agrees with true sliding on {of.label.accuracy:.1f} % of the samples; "
            f"{first.method.name} on {first.sliding.accuracy:.1f} %",
            "The simulation knows whether the contact slid (faster than 3 mm/s, sticks of less than 150 ms "
            "bridged). The arm may move while the contact still sticks, and taps slide the contact while the "
            "arm stands. So a detector that learns from the label cannot be expected to agree much better "
            "with the truth than the label does. Events as above, against true slips.",
            [Table(head, rows)],
        )
    ]


def paper_of(name: str) -> tuple[float, ...]:
    """The paper's row of Table I for a method; NaN where it has none."""
    return TABLE_1[_PAPER_ROW[name]] if name in _PAPER_ROW else (float("nan"),) * 4


def _beside(ours: float, paper: float) -> str:
    return f"{number(ours)} ({paper:.1f})"


def _table_1(confusion: Confusion) -> Sequence[float]:
    return confusion.accuracy, confusion.precision, confusion.recall, confusion.f1


def _against(confusion: Confusion) -> Sequence[float]:
    return confusion.accuracy, confusion.balanced, confusion.f1


def _missed(events: EventMetrics) -> str:
    """What becomes of the slips, in words; there may be none, or none that is answered."""
    if isnan(events.missed):
        return "and there are no slips"
    if isnan(events.onset_ms):
        return f"and misses {events.missed:.1f} % of slips"
    return f"misses {events.missed:.1f} % of slips, and is {events.onset_ms:.0f} ms late (median)"


def _event_cells(events: EventMetrics) -> list[str]:
    shares = [number(events.false_alarms_per_min), number(events.missed)]
    times = [number(time, 0) for time in (events.onset_ms, events.late_ms)]
    return [*shares, *times, number(events.repeated)]


def _of_motion(cells: Cells, kind: str, speed: float | None) -> Confusion:
    each = [cells.at(Cell(kind, speed, surface)).counts for surface in SURFACES]
    return Confusion(np.sum(each, axis=0))


def _on_surface(cells: Cells, surface: str) -> Confusion:
    return cells.confusion(lambda cell: cell.surface == surface)
