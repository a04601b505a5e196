"""The command `slipflow show`."""

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from flows.cli.live_view import Listen, NoBrowser, announce_page, watch_cells
from flows.cli.options import parse_address
from flows.cli.terminal import note

if TYPE_CHECKING:
    from connectors.web.session_requests import SessionPage
    from connectors.web.web_server import WebServer
    from storage import Session

_PANES: Final = 2
_DEFAULT: Final = "tcn"
_NONE: Final = "none"  # instead of a detector: no scores


def show(
    session: Annotated[
        list[Path],
        typer.Argument(
            metavar="SESSION [OTHER]",
            help="Folder of a session, or of a dataset with one session; two are shown side by side.",
        ),
    ],
    *,
    detector: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Detector to score with: a name, a .safetensors file, or none for no scores; two are shown"
            " side by side (default: tcn, or none if tcn was not made for the fingertip).",
        ),
    ] = None,
    listen: Listen = None,
    no_browser: NoBrowser = False,
) -> None:
    """Show a recorded session in a browser, and label it by hand.

    Scores the recorded touch again. Shows the recorded slip events if there are any, else those found by the
    detector; for two detectors, those that each finds. A slider changes the threshold. Drag over the curves
    to zoom, and over the bands below them to mark slip, static or unknown; `slipflow train` and `evaluate`
    use these labels. Ends at Ctrl-C.

    Without a detector, the page shows no probability and only recorded events; it can still be labelled.

    With two sessions or two detectors, the two pages share the selected time, the zoom and the pointer.

    Examples:
      slipflow show recordings/sessions/stroke-9 --detector psd
      slipflow show own/sessions/wood_1 --detector none
      slipflow show recordings/sessions/stroke-9 --detector tcn --detector mine.safetensors
      slipflow show recordings/sessions/stroke-8 recordings/sessions/stroke-9
    """
    from connectors.web.web_server import page_server
    from storage import Session

    host, port = parse_address("--listen", listen) if listen else ("127.0.0.1", None)
    server = page_server(host, port)  # raises an error before a long session is read
    detectors = detector or [_DEFAULT]
    count = max(len(session), len(detectors))
    if count > _PANES or (len(session) > 1 and len(detectors) not in {1, len(session)}):
        raise typer.BadParameter("give one or two sessions, and one or two detectors")
    recorded = len(session) > 1 or len(detectors) == 1
    sessions = [Session.open(each) for each in session] * (count if len(session) == 1 else 1)
    detectors *= count if len(detectors) == 1 else 1
    if not detector:
        detectors = [_fitting(each) for each in sessions]
    asyncio.run(_show(sessions, detectors, server, recorded=recorded, browse=not no_browser))


async def _show(
    sessions: "Sequence[Session]",
    detectors: Sequence[str],
    server: "WebServer",
    *,
    recorded: bool,
    browse: bool,
) -> None:
    from connectors.web.session_requests import session_requests
    from flows.run.stop_signals import signals_to

    pages: list[SessionPage] = []
    for session, detector in zip(sessions, detectors, strict=True):
        note(f"{session.name}: reading" + f" and scoring by {detector}" * (detector != _NONE))
        pages.append(await load(session, detector, recorded=recorded))
    await server.open(*session_requests(pages))
    announce_page("page, until Ctrl-C", server.url, server.login_url, browse=browse)
    stop = asyncio.Event()
    try:
        with signals_to(stop.set):
            await stop.wait()
    finally:
        await server.close()


def _fitting(session: "Session") -> str:
    """Return the default detector, or none with a note if it was not made for the fingertip of a session."""
    from operators import FingertipError, Score, Touch
    from storage import load_detector

    fingertip = session.fingertip(Touch)
    try:
        if fingertip is not None:
            Score(load_detector(_DEFAULT)).output_fingertip(fingertip)
    except FingertipError as error:
        why = f"{error.owner} needs {error.needs}; the data has {error.has}"
        how = "train a detector with `slipflow train`, or give one with --detector FILE"
        note(f"{session.name}: shown without scores: {why}: {how}")
        return _NONE
    return _DEFAULT


async def load(session: "Session", detector: str = _DEFAULT, *, recorded: bool = True) -> "SessionPage":
    """Load the data of a session that the page shows.

    Args:
        session: Session.
        detector: Name of a detector or of a file with its weights; ``none``: no scores.
        recorded: Show the recorded slip events, if there are any, and not those of the detector.

    Raises:
        InputError: if the session has no touch, is damaged or too long, or the detector is unknown.
    """
    from connectors import Replay
    from connectors.web.session_bands import SessionBands
    from connectors.web.session_page import SessionCurves
    from connectors.web.session_requests import SessionPage
    from flows.graph import Flow
    from flows.run.replay_runner import ReplayRunner
    from operators import Debounce, Faults, Labelled, Motion, Score, Slips, Touch, Truth, Zero
    from storage import load_debounce, load_detector

    session.hand_labels()  # an error of its files ends the command before the scoring
    scored = detector != _NONE
    debounce = (load_debounce(detector) if scored else None) or Debounce()
    has_slips = (recorded or not scored) and bool(session.fingers(Slips))
    if scored:
        source = f"found by {detector} now" + ", as none were recorded" * recorded
        probability = f"computed now by detector {detector}"
    else:
        source, probability = "none were recorded", "none, as there is no detector"
    about = f"Slip probability: {probability}. Slip events: {'recorded' if has_slips else source}."
    curves, bands = (
        SessionCurves(rule=debounce, about=about, flow=_flow_name(session), dataset=_dataset_name(session)),
        SessionBands(),
    )
    flow = Flow("show")
    zeroed = flow.source(Replay(session, Touch)) | Zero()
    zeroed.to(curves)
    if scored:
        scores = zeroed | Score(load_detector(detector))
        scores.to(curves)
        if not has_slips:
            (scores | debounce).to(curves)
    if has_slips:
        flow.source(Replay(session, Slips)).to(curves)
    if session.fingers(Faults):
        flow.source(Replay(session, Faults)).to(curves)
    elif faults := watch_cells(flow):
        flow.add_sink(curves, faults)
    if session.fingers(Motion):
        flow.source(Replay(session, Motion)).to(curves)
    if session.fingers(Labelled):
        flow.source(Replay(session, Labelled)).to(bands)
    if session.fingers(Truth):
        flow.source(Replay(session, Truth)).to(bands)
    await ReplayRunner(flow, session, session.name).execute()
    return SessionPage(curves, bands, session, session.name + f" by {detector}" * scored)


def _flow_name(session: "Session") -> str | None:
    name = session.describe().get("flow")
    return name if isinstance(name, str) else None


def _dataset_name(session: "Session") -> str | None:
    folder = session.folder.resolve()
    return folder.parent.parent.name if folder.parent.name == "sessions" else None
