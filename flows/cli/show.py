"""The command `slipflow show`."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.live_view import Listen, NoBrowser, announce_page
from flows.cli.options import parse_address
from flows.cli.terminal import note

if TYPE_CHECKING:
    from connectors.web.session_page import SessionCurves
    from connectors.web.web_server import WebServer
    from operators.ports import Recording


def show(
    session: Annotated[
        Path, typer.Argument(metavar="SESSION", help="Folder of a session, or of a dataset with one session.")
    ],
    *,
    detector: Annotated[
        str, typer.Option(metavar="NAME", help="Detector to score with: a name or a .safetensors file.")
    ] = "tcn",
    listen: Listen = None,
    no_browser: NoBrowser = False,
) -> None:
    """Show a recorded session in a browser.

    Scores the recorded touch again. Shows the recorded slip events if there are any, else those found by the
    detector. Ends at Ctrl-C.

    Examples:
      slipflow show recordings/sessions/stroke-9 --detector psd
    """
    from connectors.web.web_server import page_server
    from storage import Session

    host, port = parse_address("--listen", listen) if listen else ("127.0.0.1", None)
    server = page_server(host, port)  # raises an error before a long session is read
    asyncio.run(_show(Session.open(session), detector, server, browse=not no_browser))


async def _show(recording: "Recording", detector: str, server: "WebServer", *, browse: bool) -> None:
    from connectors.web.session_page import session_handlers
    from flows.run.stop_signals import signals_to

    note(f"{recording.name}: reading and scoring by {detector}")
    await server.open(session_handlers(await load(recording, detector)))
    announce_page("page, until Ctrl-C", server.url, server.login_url, browse=browse)
    stop = asyncio.Event()
    try:
        with signals_to(stop.set):
            await stop.wait()
    finally:
        await server.close()


async def load(recording: "Recording", detector: str = "tcn") -> "SessionCurves":
    """Load the data of a recording that the page shows.

    Raises:
        InputError: if the recording has no touch, is damaged or too long, or the detector is unknown.
    """
    from connectors import Replay
    from connectors.web.session_page import SessionCurves
    from flows.graph import Flow
    from flows.run.replay_runner import ReplayRunner
    from operators import Debounce, Motion, Score, Slips, Touch, Zero
    from storage import load_debounce, load_detector

    debounce = load_debounce(detector) or Debounce()
    has_slips = bool(recording.fingers(Slips))
    source = "recorded" if has_slips else f"found by {detector} now, as none were recorded"
    about = f"Slip probability: computed now by detector {detector}. Slip events: {source}."
    recorded = SessionCurves(
        threshold=debounce.threshold,
        about=about,
        flow=_flow_name(recording),
        dataset=_dataset_name(recording),
    )
    flow = Flow("show")
    zeroed = flow.source(Replay(recording, Touch)) | Zero()
    scores = zeroed | Score(load_detector(detector))
    zeroed.to(recorded)
    scores.to(recorded)
    (flow.source(Replay(recording, Slips)) if has_slips else scores | debounce).to(recorded)
    if recording.fingers(Motion):
        flow.source(Replay(recording, Motion)).to(recorded)
    await ReplayRunner(flow, recording, recording.name).execute()
    return recorded


def _flow_name(recording: "Recording") -> str | None:
    name = recording.describe().get("flow")
    return name if isinstance(name, str) else None


def _dataset_name(recording: "Recording") -> str | None:
    from storage import Session

    if not isinstance(recording, Session):
        return None
    folder = recording.folder.resolve()
    return folder.parent.parent.name if folder.parent.name == "sessions" else None
