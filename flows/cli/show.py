"""The command that shows recorded sessions in a browser."""

import asyncio
import signal
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.listening import listening
from flows.cli.live_page import Listen, NoBrowser, invite
from flows.cli.options import told

if TYPE_CHECKING:
    from connectors.web.recorded_page import Recorded
    from operators.ports import Recording

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415


def show(
    session: Annotated[
        Path, typer.Argument(metavar="SESSION", help="A session's folder, or a dataset's that holds one.")
    ],
    *,
    detector: Annotated[
        str, typer.Option(metavar="NAME", help="Scores it: a built-in detector, or a file of weights.")
    ] = "tcn",
    listen: Listen = None,
    no_browser: NoBrowser = False,
) -> None:
    """Show a recorded session in a browser.

    Choose an instant, or play it.

    Its touch is scored again. Slip events are those that were recorded; where none were, those found now.
    Ends at Ctrl-C.
    """
    from connectors.web.access import Access
    from storage import Session

    host, port = listening("--listen", listen) if listen else ("127.0.0.1", None)
    Access.of(host, None)  # refused before a long session is read
    recording = Session.open(session)
    asyncio.run(_show(recording, detector, host, port, browse=not no_browser))


async def _show(recording: "Recording", detector: str, host: str, port: int | None, *, browse: bool) -> None:
    from connectors.web.session_page import Scrubber

    told(f"{recording.name}: reading it, and scoring it by {detector}")
    recorded = await load(recording, detector)
    scrubber = Scrubber(recorded, port, host)
    await scrubber.open()
    invite("page, until Ctrl-C", scrubber.url, scrubber.entrance, browse=browse)
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        with suppress(RuntimeError, ValueError):  # not in the main thread
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
    try:
        await stop.wait()
    finally:
        await scrubber.close()


async def load(recording: "Recording", detector: str = "tcn") -> "Recorded":
    """Take what the page shows of a recording into memory.

    Raises:
        InputError: if it holds no touch, is damaged, or is too long; or if there is no such detector.
    """
    from connectors import Replay
    from connectors.web.recorded_page import Recorded
    from flows.graph import Flow
    from flows.run.replay_runner import ReplayRunner
    from operators import Debounce, Motion, Score, Slips, Touch, Zero
    from storage import load_debounce, load_detector

    debounce = load_debounce(detector) or Debounce()
    recalled = bool(recording.fingers(Slips))
    found = "those that were recorded" if recalled else f"those that {detector} finds now: none were recorded"
    about = f"Slip probability: computed now, by the detector {detector}. Slip events: {found}."
    recorded = Recorded(
        threshold=debounce.threshold, about=about, flow=_flow(recording), dataset=_dataset(recording)
    )
    flow = Flow("show")
    zeroed = flow.source(Replay(recording, Touch)) | Zero()
    scores = zeroed | Score(load_detector(detector))
    zeroed.to(recorded)
    scores.to(recorded)
    (flow.source(Replay(recording, Slips)) if recalled else scores | debounce).to(recorded)
    if recording.fingers(Motion):
        flow.source(Replay(recording, Motion)).to(recorded)
    await ReplayRunner(flow, recording, recording.name).execute()
    return recorded


def _flow(recording: "Recording") -> str | None:
    """The flow that recorded it, where it tells."""
    name = recording.describe().get("flow")
    return name if isinstance(name, str) else None


def _dataset(recording: "Recording") -> str | None:
    """The name of the dataset that holds it, where it is still in one."""
    from storage import Session

    if not isinstance(recording, Session):
        return None
    folder = recording.folder.resolve()
    return folder.parent.parent.name if folder.parent.name == "sessions" else None
