"""The command `slipflow show`."""

import asyncio
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from flows.cli.live_view import announce_page
from flows.cli.options import Listen, NoBrowser, parse_address
from flows.cli.terminal import note

if TYPE_CHECKING:
    from connectors.web.session_page import SessionPage
    from connectors.web.web_server import WebServer
    from storage import Session

_DEFAULT: Final = "tcn"
_NONE: Final = "none"  # instead of a detector: no scores


def show(
    session: Annotated[
        Path, typer.Argument(metavar="SESSION", help="Folder of a session, or of a dataset with one session.")
    ],
    *,
    detector: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Detector to score with: a name, a .safetensors file, or none for no scores (default: tcn,"
            " or none if tcn was not made for the fingertip).",
        ),
    ] = None,
    listen: Listen = None,
    no_browser: NoBrowser = False,
) -> None:
    """Show a recorded session in a browser, and label it by hand.

    The detector scores the recorded touch again. Shows the recorded slip events if there are any, else those
    of the detector. Drag over the curves to zoom, and over the bands below them to mark slip, static or
    unknown; `slipflow train` and `evaluate` use these labels. Ends at Ctrl-C.

    Examples:
      slipflow show recordings/sessions/stroke-9 --detector psd
      slipflow show own/sessions/wood_1 --detector none
    """
    from connectors.web.web_server import page_server
    from storage import Session
    from storage.layout import SESSIONS

    host, port = parse_address("--listen", listen) if listen else ("127.0.0.1", None)
    server = page_server(host, port)  # raises an error before a long session is read
    opened = Session.open(session)
    detector = detector or _fitting(opened)
    asyncio.run(_show(opened, detector, server, browse=not no_browser))
    if detector == _NONE:
        folder = opened.folder.absolute()
        dataset = folder.parent.parent if folder.parent.name == SESSIONS else folder
        note(f"next: slipflow train {quote(str(dataset))} -o {quote(dataset.name)}.safetensors")


async def _show(session: "Session", detector: str, server: "WebServer", *, browse: bool) -> None:
    from flows.run.supervision import signals_to

    note(f"{session.name}: reading" + f" and scoring by {detector}" * (detector != _NONE))
    page = await load(session, detector)
    await server.open(*page.routes)
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


async def load(session: "Session", detector: str = _DEFAULT) -> "SessionPage":
    """Load the data of a session that the page shows; the detector ``none`` gives no scores.

    Raises:
        InputError: if the session has no touch, is damaged or too long, or the detector is unknown.
    """
    from connectors import Replay
    from connectors.web.session_page import SessionPage
    from flows.graph import Flow
    from flows.run.replay_runner import ReplayRunner
    from operators import Debounce, Labelled, Motion, Score, Slips, Touch, Zero
    from storage import load_debounce, load_detector

    session.hand_labels()  # an error of its files ends the command before the scoring
    scored, has_slips = detector != _NONE, bool(session.fingers(Slips))
    debounce = load_debounce(detector) if scored else Debounce()
    page = SessionPage(session, debounce, detector if scored else None, recorded=has_slips)
    flow = Flow("show")
    zeroed = flow.source(Replay(session, Touch)) | Zero()
    zeroed.to(page)
    if scored:
        scores = zeroed | Score(load_detector(detector))
        scores.to(page)
        if not has_slips:
            (scores | debounce).to(page)
    kinds: tuple[type[Any], ...] = (Slips, Motion, Labelled)
    for kind in kinds:
        if session.fingers(kind):
            flow.source(Replay(session, kind)).to(page)
    await ReplayRunner(flow, session, session.name).execute()
    return page
