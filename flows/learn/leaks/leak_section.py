"""Section of a report that names the leaks."""

from collections.abc import Sequence

from flows.learn.leaks.leak import Leak
from flows.report.report_page import Section
from flows.report.table import Table, Value, counted


def leak_section(leaks: Sequence[Leak], unchecked: Sequence[str] = ()) -> Section:
    """Return the section with the leaks.

    Args:
        leaks: Leaks that were found.
        unchecked: Methods whose model cards do not list the recordings of their training.
    """
    rows: list[list[Value]] = [[each.kind, each.method or "all", each.finding] for each in leaks]
    kinds = ", ".join(dict.fromkeys(each.kind for each in leaks))
    text = (
        "Checked: rows that recordings of different splits share (copies, pieces and overlaps at any shift); "
        "recordings that continue each other; surfaces or objects that are in training as well; recordings "
        "that a model was trained on, or that its checkpoint, debounce or thresholds were chosen on; methods "
        "whose answer is constant. Copies that were rescaled or resampled are not found."
    )
    if unchecked:
        text += (
            f" The cards of {', '.join(unchecked)} do not list the recordings of their training: only the "
            "dataset's sha256 was compared."
        )
    finding = f"{counted(len(leaks), 'leak')} found: {kinds}" if leaks else "No leak was found"
    return Section("leaks", finding, text, [Table(["leak", "method", "finding"], rows)] if leaks else [])
