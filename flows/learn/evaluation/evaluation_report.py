"""Report of an evaluation: one section per question, with the paper's figures for comparison."""

from collections.abc import Mapping, Sequence
from math import isnan, nan
from typing import Final

import numpy as np

from flows.learn.evaluation import evaluation_figures as figures
from flows.learn.evaluation.evaluation_study import PAPER_RULE, Evaluation, MethodResult
from flows.learn.evaluation.event_metrics import AHEAD, EventMetrics
from flows.learn.evaluation.figures_table import FIGURES_DECIMALS, FIGURES_HEAD, figures_cells
from flows.learn.evaluation.intervals import DRAWS
from flows.learn.evaluation.motion_metrics import MotionConfusions, MotionKind
from flows.learn.evaluation.published import SURFACES, TABLE_1, TABLE_3, TABLE_3_ANY
from flows.learn.evaluation.sample_metrics import EDGES, Confusion
from flows.learn.evaluation.target_table import (
    BY_HAND,
    TARGET_DECIMALS,
    TITLES,
    event_text,
    lead_text,
    target_cells,
    target_head,
)
from flows.learn.labelled_recordings import TARGETS
from flows.learn.leaks.leak_section import leak_section
from flows.report.report_page import Report, Section
from flows.report.table import Table, Value, counted, quantity
from operators import ms

# row of Table I that a method is compared with
_PAPER_ROW: Final[Mapping[str, str]] = {
    "psd": "PSD threshold",
    "psd_1s": "PSD threshold",
    "frequency_cnn": "frequency CNN",
    "frequency_cnn_interleaved": "frequency CNN",
    "paper_tcn": "TCN",
    "tcn": "TCN",
}
_SHARES: Final = ("accuracy", "precision", "recall", "F1")
_EVENTS: Final = ("false/min", "missed %", "delay ms", "90 % ms", "repeated %")
_IN_MS: Final = {"delay ms": 0, "90 % ms": 0}  # decimals
_NEAR: Final = 60  # ms
_FAR: Final = 100  # ms


def evaluation_report(of: Evaluation, command: str) -> Report:
    """Return the report of an evaluation that `command` made."""
    text = (
        f"{counted(len(of.results), 'method')} on the {of.split} split of {of.dataset}: "
        f"{counted(of.recordings, 'recording')}, {of.minutes:.1f} minutes, {counted(of.samples, 'sample')} "
        f"at {of.sampling.rate:g} Hz, split by recording. Baselines were fitted to recordings that are not "
        "evaluated."
        + (f" {of.by_hand[0].upper()}{of.by_hand[1:]}; all others by arm speed." if of.by_hand else "")
        + "".join(f" Leak: {leak.finding}." for leak in of.leaks)
    )
    facts = {
        "dataset": of.dataset,
        "split": of.split,
        "recordings": of.recordings,
        "samples": of.samples,
        "minutes": round(of.minutes, 3),
        "static": round(of.static, 3),
        "budget": of.budget,
        "missing": dict(of.missing),
        "leaks": [leak.json() for leak in of.leaks],
    }
    best, first = of.results[0], of.leader
    title = f"Slip detectors on {of.dataset}: {best.method.name} reaches {_accuracy(best)}"
    if first is not best:
        title += f", {first.method.name} {_accuracy(first)}"
    sections = [
        accuracy(of),
        leak_section(of.leaks, of.unchecked),
        intervals(of),
        confusions(of),
        curves(of),
        events(of),
        *motions(of),
        changes(of),
        *sliding(of),
    ]
    return Report(title, text, sections, command, facts)


def accuracy(of: Evaluation) -> Section:
    """Return the section with Table I."""
    first = of.leader
    rows: list[list[Value]] = [
        [
            each.method.name,
            *_shares(each.confusion),
            *(TABLE_1[_PAPER_ROW[each.method.name]] if each.method.name in _PAPER_ROW else (nan,) * 4),
            each.confusion.balanced,
            each.method.origin,
        ]
        for each in of.results
    ]
    head = ["method", *_SHARES, *(f"paper {name}" for name in _SHARES), "balanced", "origin"]
    return Section(
        "accuracy",
        f"{first.method.name} classifies {first.confusion.accuracy:.1f} % of the samples correctly; "
        f"the paper's TCN {TABLE_1['TCN'][0]} % of its real ones",
        f"The paper's Table I, in %: averages over the two classes, weighted by their share, on all "
        f"{counted(of.samples, 'sample')} of {counted(of.recordings, 'recording')} ({of.static:.0f} % "
        "static). The paper's figures are of its own, real test set."
        + "".join(f" Not evaluated: {name}, {reason}." for name, reason in of.missing.items()),
        [Table(head, rows)],
    )


def intervals(of: Evaluation) -> Section:
    """Return the section with the intervals over recordings."""
    first = of.leader.figures.balanced
    rows: list[list[Value]] = [[each.method.name, *figures_cells(each.figures)] for each in of.results]
    return Section(
        "intervals",
        f"The balanced accuracy of {of.leader.method.name} is {quantity(first.value, '%')}, "
        f"{first.interval() or 'without an interval'} over recordings",
        f"95 % intervals from {DRAWS} draws of {counted(of.recordings, 'recording')} with replacement: "
        "samples of a recording are alike. Fewer than three recordings give no interval. Far: balanced "
        "accuracy 100 ms or more from any change of the label. Events: reported events per minute of "
        "recording; false alarms: per static minute.",
        [Table(["method", *FIGURES_HEAD], rows, decimals=FIGURES_DECIMALS)],
    )


def confusions(of: Evaluation) -> Section:
    """Return the section with the confusion of slip and static."""
    first = of.leader
    recalls = zip(("static", "slip"), first.confusion.recalls, strict=True)
    right = " and ".join(f"{share:.1f} % of {name}" for name, share in recalls if not isnan(share))
    rows: list[list[Value]] = [
        [each.method.name, *map(int, each.confusion.counts.ravel()), *each.confusion.recalls]
        for each in of.results
    ]
    head = ["method", "static as static", "static as slip", "slip as static", "slip as slip"]
    return Section(
        "confusion",
        f"{first.method.name} recognises {right or 'no sample'}",
        "Samples by label and prediction; percentages are of the samples with the same label.",
        [Table([*head, "static %", "slip %"], rows)],
        lambda: figures.confusions(of.results),
        terminal=False,
    )


def curves(of: Evaluation) -> Section:
    """Return the section with ROC and reliability."""
    first = of.leader
    best = max(of.results, key=lambda each: each.roc.area)
    rows: list[list[Value]] = [
        [each.method.name, 100 * each.roc.area, each.reliability.error] for each in of.results
    ]
    return Section(
        "curves",
        f"The area under the ROC of {best.method.name} is {quantity(100 * best.roc.area, '%')}; "
        f"the probabilities of {first.method.name} are off by {first.reliability.error:.1f} % on average",
        "The expected calibration error is the mean distance between probability and share of slip in ten "
        "bins, weighted by their number of samples.",
        [Table(["method", "area %", "calibration error %"], rows)],
        lambda: figures.curves(of.results),
        terminal=False,
    )


def events(of: Evaluation) -> Section:
    """Return the section with the quality of slip events."""
    first = of.leader
    rows: list[list[Value]] = [
        [
            each.method.name,
            *_event_cells(each.events),
            each.debounce.threshold,
            each.debounce.consecutive,
            each.debounce.release,
            each.chosen_on,
        ]
        for each in of.results
    ]
    paper: list[list[Value]] = [[each.method.name, *_event_cells(each.paper_rule)] for each in of.results]
    total, rule = first.events, of.sampling.rule(PAPER_RULE)
    settings = f"{rule.threshold:g} / {rule.consecutive} / {rule.release}"
    return Section(
        "events",
        f"{first.method.name} {event_text(total.false_alarms_per_min, total.missed, total.onset_ms)}",
        f"{counted(total.slips, 'slip')} by the label in {total.minutes:.1f} static minutes. An onset from "
        "50 ms before a slip to 150 ms after it detects it; others are false alarms. Each slip needs an "
        "onset of its own. Repeated: onsets of a slip after its first, of all slips. Settings: the "
        "probability from which a sample counts as slip (threshold), and the numbers of consecutive "
        "decisions that begin a slip (on) and end it (off). Settings chosen on the validation split have "
        "the least delay within "
        f"{of.budget:g} false alarms per static minute and 2 % missed slips.",
        [
            Table(
                ["method", *_EVENTS, "threshold", "on", "off", "chosen on"],
                rows,
                decimals={**_IN_MS, "threshold": 3},
            ),
            Table(["method", *_EVENTS], paper, f"with the paper's settings, {settings}", _IN_MS),
        ],
        lambda: figures.delays(of.results),
    )


def motions(of: Evaluation) -> list[Section]:
    """Return the sections with Table III; [] if the strokes are unknown."""
    first = of.leader
    if not first.motions.kinds:
        return []
    paper = next((each for each in of.results if each.method.name == "paper_tcn"), None)
    drawn = [first] if paper in (None, first) else [first, paper]
    pairs = [
        (first.motions.at(MotionKind(kind, speed, surface)).f1, theirs)
        for (kind, speed), row in TABLE_3.items()
        for surface, theirs in zip(SURFACES, row, strict=False)
    ]
    known = [(ours, theirs) for ours, theirs in pairs if not isnan(ours)]
    reached = sum(ours >= theirs for ours, theirs in known)
    finding = (
        f"at or above the paper's F1 in {reached} of {counted(len(known), 'kind')} of motion and surface"
    )
    rotation = first.motions.confusion(lambda motion: motion.kind == "rotation").f1
    text = "F1 averaged over the two classes by their share, %, by motion and surface (cylinders by axis)."
    others = [each for each in of.results if each is not first]
    published: list[list[Value]] = [
        [motion_name(kind, speed), *row] for (kind, speed), row in TABLE_3.items()
    ]
    published.append(["any", *TABLE_3_ANY, None])
    sections = [
        Section(
            "motions",
            f"{first.method.name} is {finding}" + ("" if isnan(rotation) else f"; rotation {rotation:.1f} %"),
            f"The paper's Table III: {text}",
            [
                motion_table(first.method.name, first.motions),
                Table(_motion_head(), published, "the paper's TCN, real recordings"),
            ],
            lambda: figures.motion({each.method.name: each.motions for each in drawn}),
        )
    ]
    if others:
        tables = [motion_table(each.method.name, each.motions) for each in others]
        sections.append(
            Section("other-motions", "Table III of the other methods", text, tables, terminal=False)
        )
    return sections


def motion_table(name: str, confusions: MotionConfusions) -> Table:
    """Return Table III of one method."""
    rows = list[list[Value]]()
    for kind, speed in TABLE_3:
        each = [confusions.at(MotionKind(kind, speed, surface)) for surface in SURFACES]
        total = Confusion(np.sum([found.counts for found in each], axis=0))
        rows.append([motion_name(kind, speed), *(found.f1 for found in [*each, total])])
    every = [_on_surface(confusions, surface).f1 for surface in SURFACES]
    return Table(_motion_head(), [*rows, ["any", *every, confusions.confusion().f1]], name)


def motion_name(kind: str, speed: float | None) -> str:
    """Return the name of a kind of motion in tables."""
    return "rotation" if speed is None else f"{kind}, {100 * speed:g} cm/s"


def changes(of: Evaluation) -> Section:
    """Return the section with the accuracy by distance from a change of the label."""
    first, name = of.leader.changes, of.leader.method.name
    near, far = first.near(_NEAR), first.far(_FAR)
    finding = f"{name} makes no error"
    if not isnan(near):
        finding = f"{near:.0f} % of the errors of {name} lie within {_NEAR} ms of a change of the label"
    if not isnan(far):
        finding += f"; {_FAR} ms or more from any change, {far:.1f} % are correct"
    spans = [*first.spans, f"{EDGES[-1]} or more"]
    rows: list[list[Value]] = [
        [span, int(first.samples[index]), *(float(each.changes.accuracy[index]) for each in of.results)]
        for index, span in enumerate(spans)
    ]
    return Section(
        "changes",
        finding,
        "Accuracy, %, by distance from the nearest change of the label. A label by arm speed follows the "
        "speed as it arrived; the contact starts and stops sliding up to 100 ms earlier or later.",
        [Table(["ms to the change", "samples", *(each.method.name for each in of.results)], rows)],
        lambda: figures.changes(of.results),
        terminal=False,
    )


def sliding(of: Evaluation) -> list[Section]:
    """Return the section with the comparison of both targets; [] if true sliding is unknown."""
    if len(of.label) < len(TARGETS):
        return []
    label, titles = ("label by arm speed and hand", BY_HAND) if of.by_hand else ("arm-speed label", TITLES)
    rows: list[list[Value]] = [[f"the {label}", None, *target_cells(of.label)]]
    rows += [[each.method.name, each.method.target, *target_cells(each.performance)] for each in of.results]
    first = of.leader.performance["sliding"]
    return [
        Section(
            "sliding",
            f"Against true sliding the {label} has a balanced accuracy of "
            f"{quantity(of.label['sliding'].balanced, '%')}, {of.leader.method.name} "
            f"{quantity(first.balanced, '%')}; it reports slips {lead_text(first)} the label",
            "True sliding is the simulated sliding of the contact (faster than 3 mm/s, sticks of up to "
            "150 ms included). The arm may move while the contact still sticks, and taps slide the contact "
            "while the arm stands still. Trained on: the target of a model's training, arm speed or true "
            "sliding. False alarms, missed slips and median onset delay are of events as above, against the "
            "slips of each target. Lead: median time from an onset to the change of the {label}, for onsets "
            f"up to {AHEAD // ms} ms before it.",
            [Table(["method", "trained on", *target_head(of.label, titles)], rows, decimals=TARGET_DECIMALS)],
        )
    ]


def _on_surface(confusions: MotionConfusions, surface: str) -> Confusion:
    return confusions.confusion(lambda motion: motion.surface == surface)


def _motion_head() -> list[str]:
    return ["motion", *(surface.replace("_", " ") for surface in SURFACES), "all"]


def _accuracy(result: MethodResult) -> str:
    return quantity(result.confusion.accuracy, "%")


def _shares(confusion: Confusion) -> Sequence[float]:
    return confusion.accuracy, confusion.precision, confusion.accuracy, confusion.f1


def _event_cells(events: EventMetrics) -> list[float]:
    return [
        events.false_alarms_per_min,
        events.missed,
        events.onset_ms,
        events.late_ms,
        events.repeated,
    ]
