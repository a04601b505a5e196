"""What a plan will do, and what was collected, for a person and for a program."""

from collections.abc import Sequence
from typing import Any

from flows.lab.collection.arm_path import Extent, Place, Pose
from flows.lab.collection.stroke_plan import Session, Stroke, extent
from operators.ports import Run


def planned(sessions: Sequence[Session], low: Place, high: Place, here: Pose | None = None) -> dict[str, Any]:
    """A plan's path, its duration and its bounds, within a workspace (m), from where the arm is, if known."""
    whole = extent(sessions, here)
    contacts = [_contact(stroke, session) for session in sessions for stroke in session.strokes]
    return {
        "sessions": [
            {
                "session": session.name,
                "surface": session.surface.curvature,
                "radius": None if session.surface.curvature == "plane" else session.surface.radius,
                "speed": session.speed,
                "split": session.split,
                "strokes": len(session.strokes),
                "seconds": round(_reach(session).seconds, 3),
                "low": list(_reach(session).low),
                "high": list(_reach(session).high),
            }
            for session in sessions
        ],
        "strokes": sum(len(session.strokes) for session in sessions),
        "seconds": round(whole.seconds, 3),
        "contact_seconds": round(sum(contacts), 3),
        "low": list(whole.low),
        "high": list(whole.high),
        "workspace": [*low, *high],
        "depth": sessions[0].depth,
        "force": sessions[0].force,
    }


def as_table(plan: dict[str, Any]) -> str:
    """The same as text.

    >>> print(as_table({"sessions": [], "strokes": 0, "seconds": 75.0, "low": [0, 0, 0], "high": [1, 1, 1],
    ...     "contact_seconds": 30.0, "workspace": [0, 0, 0, 1, 1, 1], "depth": None, "force": 2.0}))
    session                      strokes      time   x mm            y mm            z mm            split
    in all                             0  1.2 min   0 .. 1000       0 .. 1000       0 .. 1000
    workspace                                       0 .. 1000       0 .. 1000       0 .. 1000
    in contact                            0.5 min: the rest is baselines, and the ways from stroke to stroke
    pressed with 2 N, each stroke at the depth where it is felt; times and bounds are those of the deepest
    """
    head = f"{'session':28} {'strokes':>7} {'time':>9}   {'x mm':15} {'y mm':15} {'z mm':15} split"
    rows = [
        f"{each['session']:28} {each['strokes']:7} {each['seconds']:7.1f} s"
        f"   {_spans(each['low'], each['high'])} {each['split']}"
        for each in plan["sessions"]
    ]
    low, high = plan["workspace"][:3], plan["workspace"][3:]
    minutes = f"{plan['seconds'] / 60:.1f} min"
    whole = f"{'in all':28} {plan['strokes']:7} {minutes:>8}   {_spans(plan['low'], plan['high'])}"
    room = f"{'workspace':47} {_spans(low, high)}".rstrip()
    contact = f"{plan['contact_seconds'] / 60:.1f} min"
    touching = f"{'in contact':28} {contact:>16}: the rest is baselines, and the ways from stroke to stroke"
    return "\n".join([head, *rows, whole.rstrip(), room, touching, _pressed(plan)])


def summary(runs: Sequence[Run], strokes: int) -> dict[str, Any]:
    """What was collected."""
    return {
        "strokes": strokes,
        "sessions": [
            {
                "session": run.session,
                "rows": {name: source.rows for name, source in run.sources.items()},
                "gaps": sum(len(source.gaps) for source in run.sources.values()),
                "dropped": sum(sink.dropped for sink in run.sinks.values() if sink.records),
                "error": run.error or None,
            }
            for run in runs
        ],
    }


def as_text(collected: dict[str, Any]) -> str:
    """The same as text."""
    rows = [
        f"{each['session']:40} {', '.join(f'{rows} {name}' for name, rows in each['rows'].items())}"
        f"{'' if not each['gaps'] else ', gaps ' + str(each['gaps'])}"
        f"{'' if not each['dropped'] else ', dropped ' + str(each['dropped'])}"
        f"{'' if not each['error'] else ', ended early'}"
        for each in collected["sessions"]
    ]
    many = "session" if len(rows) == 1 else "sessions"
    return "\n".join([*rows, f"{collected['strokes']} strokes in {len(rows)} {many}"])


def _pressed(plan: dict[str, Any]) -> str:
    if plan["force"] is None:
        return f"pressed by {1000 * plan['depth']:g} mm beyond the first touch"
    found = "each stroke at the depth where it is felt; times and bounds are those of the deepest"
    return f"pressed with {plan['force']:g} N, {found}"


def _reach(session: Session) -> Extent:
    return Extent.of(session.steps, session.begin.pose)


def _contact(stroke: Stroke, session: Session) -> float:
    """How long a stroke touches the surface, s."""
    down = Extent.of(stroke.approach, session.begin.pose).end
    return Extent.of(stroke.contact, down).seconds


def _spans(low: Sequence[float], high: Sequence[float]) -> str:
    return " ".join(f"{f'{round(1000 * a)} .. {round(1000 * b)}':15}" for a, b in zip(low, high, strict=True))
