"""Reports of a planned path and of a collection, as text."""

from collections.abc import Sequence

from flows.lab.collection.arm_path import Extent
from flows.lab.collection.collector import Collector
from flows.lab.collection.stroke_plan import PlannedPath


def path_text(path: PlannedPath) -> str:
    """Return duration and bounds of the sessions of a plan, its workspace, and how it presses."""
    head = f"{'session':28} {'strokes':>7} {'time':>9}   {'x mm':15} {'y mm':15} {'z mm':15} split"
    rows = list[str]()
    for each in path.series:
        extent = Extent.of(each.steps, each.begin.poses[-1])
        size = f"{each.name:28} {len(each.strokes):7} {extent.seconds:7.1f} s"
        rows.append(f"{size}   {_spans(extent.low, extent.high)} {each.split}")
    whole, strokes = path.extent, sum(len(each.strokes) for each in path.series)
    minutes = f"{whole.seconds / 60:.1f} min"
    return "\n".join(
        [
            head,
            *rows,
            f"{'total':28} {strokes:7} {minutes:>8}   {_spans(whole.low, whole.high)}".rstrip(),
            f"{'workspace':47} {_spans(path.low, path.high)}".rstrip(),
            f"pressed {1000 * path.plan.path.depth:g} mm after first contact",
        ]
    )


def result_text(result: Collector) -> str:
    """Return the sessions of a collection with their rows, gaps and dropped batches."""
    rows = list[str]()
    for run in result.runs:
        counts = ", ".join(f"{source.rows} {name}" for name, source in run.sources.items())
        gaps = sum(len(source.gaps) for source in run.sources.values())
        dropped = sum(sink.dropped for sink in run.sinks.values() if sink.records)
        notes = [f", gaps {gaps}"] * bool(gaps) + [f", dropped {dropped}"] * bool(dropped)
        notes += [", ended early"] * bool(run.error)
        rows.append(f"{run.session:40} {counts}{''.join(notes)}")
    many = "session" if len(rows) == 1 else "sessions"
    return "\n".join([*rows, f"{result.driver.strokes} strokes in {len(rows)} {many}"])


def _spans(low: Sequence[float], high: Sequence[float]) -> str:
    return " ".join(f"{f'{round(1000 * a)} .. {round(1000 * b)}':15}" for a, b in zip(low, high, strict=True))
