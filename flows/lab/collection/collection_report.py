"""Reports of a planned path and of a collection, as JSON data and as text."""

from collections.abc import Sequence
from typing import Any

from connectors.ur.control_process import Pose
from connectors.ur.path_follower import Point
from flows.lab.collection.arm_path import Extent
from flows.lab.collection.collector import Collector
from flows.lab.collection.stroke_plan import Stroke, StrokeSeries, total_extent


def describe_plan(
    series: Sequence[StrokeSeries], low: Point, high: Point, here: Pose | None = None
) -> dict[str, Any]:
    """Return the path, duration and bounds of a plan in a workspace (m), from the arm's pose if known."""
    whole, press = total_extent(series, here), series[0].plan.press
    contacts = [_contact_seconds(stroke, each) for each in series for stroke in each.strokes]
    return {
        "sessions": [_describe_series(each) for each in series],
        "strokes": sum(len(each.strokes) for each in series),
        "seconds": round(whole.seconds, 3),
        "contact_seconds": round(sum(contacts), 3),
        "low": list(whole.low),
        "high": list(whole.high),
        "workspace": [*low, *high],
        "depth": press.depth if press.force is None else None,
        "force": press.force,
    }


def plan_table(plan: dict[str, Any]) -> str:
    """Return the result of `describe_plan` as text.

    >>> print(plan_table({"sessions": [], "strokes": 0, "seconds": 75.0, "low": [0, 0, 0], "high": [1, 1, 1],
    ...     "contact_seconds": 30.0, "workspace": [0, 0, 0, 1, 1, 1], "depth": None, "force": 2.0}))
    session                      strokes      time   x mm            y mm            z mm            split
    total                              0  1.2 min   0 .. 1000       0 .. 1000       0 .. 1000
    workspace                                       0 .. 1000       0 .. 1000       0 .. 1000
    in contact                            0.5 min; the rest is baselines and moves through the air
    pressed with 2 N, at the depth found for each stroke; times and bounds are for the greatest depth
    """
    head = f"{'session':28} {'strokes':>7} {'time':>9}   {'x mm':15} {'y mm':15} {'z mm':15} split"
    rows = [
        f"{each['session']:28} {each['strokes']:7} {each['seconds']:7.1f} s"
        f"   {_spans(each['low'], each['high'])} {each['split']}"
        for each in plan["sessions"]
    ]
    low, high = plan["workspace"][:3], plan["workspace"][3:]
    minutes = f"{plan['seconds'] / 60:.1f} min"
    total = f"{'total':28} {plan['strokes']:7} {minutes:>8}   {_spans(plan['low'], plan['high'])}"
    box = f"{'workspace':47} {_spans(low, high)}".rstrip()
    contact = f"{plan['contact_seconds'] / 60:.1f} min"
    touching = f"{'in contact':28} {contact:>16}; the rest is baselines and moves through the air"
    if plan["force"] is None:
        pressed = f"pressed {1000 * plan['depth']:g} mm after first contact"
    else:
        found = "at the depth found for each stroke; times and bounds are for the greatest depth"
        pressed = f"pressed with {plan['force']:g} N, {found}"
    return "\n".join([head, *rows, total.rstrip(), box, touching, pressed])


def describe_result(result: Collector) -> dict[str, Any]:
    """Return the strokes and sessions of a collection."""
    return {
        "strokes": result.driver.strokes,
        "sessions": [
            {
                "session": run.session,
                "rows": {name: source.rows for name, source in run.sources.items()},
                "gaps": sum(len(source.gaps) for source in run.sources.values()),
                "dropped": sum(sink.dropped for sink in run.sinks.values() if sink.records),
                "error": run.error or None,
            }
            for run in result.runs
        ],
        "error": result.error or None,
    }


def result_text(result: dict[str, Any]) -> str:
    """Return the result of `describe_result` as text."""
    rows = [
        f"{each['session']:40} {', '.join(f'{rows} {name}' for name, rows in each['rows'].items())}"
        f"{'' if not each['gaps'] else ', gaps ' + str(each['gaps'])}"
        f"{'' if not each['dropped'] else ', dropped ' + str(each['dropped'])}"
        f"{'' if not each['error'] else ', ended early'}"
        for each in result["sessions"]
    ]
    many = "session" if len(rows) == 1 else "sessions"
    return "\n".join([*rows, f"{result['strokes']} strokes in {len(rows)} {many}"])


def _describe_series(series: StrokeSeries) -> dict[str, Any]:
    path = Extent.of(series.steps, series.begin.pose)
    return {
        "session": series.name,
        **series.describe(),
        "seconds": round(path.seconds, 3),
        "low": list(path.low),
        "high": list(path.high),
    }


def _contact_seconds(stroke: Stroke, series: StrokeSeries) -> float:
    """Return the time for which a stroke touches the surface, s."""
    down = Extent.of(stroke.approach, series.begin.pose).end
    return Extent.of(stroke.contact, down).seconds


def _spans(low: Sequence[float], high: Sequence[float]) -> str:
    return " ".join(f"{f'{round(1000 * a)} .. {round(1000 * b)}':15}" for a, b in zip(low, high, strict=True))
