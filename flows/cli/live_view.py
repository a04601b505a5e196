"""Live page and metrics of a running flow: the sinks that serve them."""

import os
import sys
from typing import TYPE_CHECKING

from flows.cli.options import parse_address
from flows.cli.terminal import note

if TYPE_CHECKING:
    from flows.graph import Flow
    from flows.graph.node import Node
    from operators.batch import Batch


def add_page(flow: "Flow", listen: str | None = None, *, browse: bool = False) -> None:
    """Add a sink to a flow that shows it on the live page, with the threshold of its first `Debounce`.

    A flow without `Health` gets one, so that the page marks dead, stuck and saturated cells.

    Args:
        flow: Flow to change.
        listen: Address as ``[HOST:]PORT``.
        browse: Open a browser if a person uses this terminal.

    Raises:
        ParameterError: if the page cannot be served at this address.
    """
    from connectors import Page
    from operators import Debounce

    host, port = parse_address("--listen", listen) if listen else ("127.0.0.1", None)
    thresholds = [node.part.threshold for node in flow.nodes if isinstance(node.part, Debounce)]

    def announce(url: str) -> None:
        announce_page("live page", url, page.login_url, browse=browse)

    watch_cells(flow)
    page = Page(port, host, threshold=thresholds[0] if thresholds else None, opened=announce)
    for node in page_streams(flow):
        flow.add_sink(page, node)


def page_streams(flow: "Flow") -> "list[Node]":
    """Return the streams that the page shows: the first of each type, zeroed touch if there is any."""
    from operators import Faults, Motion, Scores, Slips, Touch, Zeroed

    first: dict[type[Batch] | None, Node] = {}
    for node in flow.nodes:
        first.setdefault(node.gives, node)
    kinds = (Zeroed if Zeroed in first else Touch, Motion, Scores, Slips, Faults)
    return [first[kind] for kind in kinds if kind in first]


def watch_cells(flow: "Flow") -> "Node | None":
    """Add `Health` to the first raw touch of a known range and return it, unless the flow has faults."""
    from operators import Faults, Health, Source, Touch
    from operators.batch import s

    if any(node.gives is Faults for node in flow.nodes):
        return None
    for node in flow.nodes:
        fingertip = node.part.fingertip if isinstance(node.part, Source) else None
        if node.gives is Touch and fingertip is not None and fingertip.range is not None:
            low, high = sorted(fingertip.range)
            end = max(1, (high - low) // 100)  # counts at each end of the range
            return flow.add("faults", Health(clear_after=2 * s, floor=low + end, ceiling=high - end), node)
    return None


def add_metrics(flow: "Flow", listen: str) -> None:
    """Add a sink to a flow that serves metrics of its run, and of its first slips, faults and scores.

    `listen` is the address as ``[HOST:]PORT``.
    """
    from connectors import Metrics
    from operators import Faults, Scores, Slips

    host, port = parse_address("--metrics", listen)
    kinds = Slips, Faults, Scores
    inputs = [next((node for node in flow.nodes if node.gives is kind), None) for kind in kinds]
    metrics = Metrics(port, host, opened=lambda url: note(f"metrics: {url}"))
    flow.add("metrics", metrics, *filter(None, inputs))


def announce_page(title: str, url: str, login_url: str, *, browse: bool) -> None:
    """Print the address of a page, and open a browser if `browse` is set and a person uses this terminal.

    `login_url` is the URL with the access token. It is printed on a terminal only, never into a log. The
    browser gets the URL without it, because all users of this machine can read the arguments of a process.
    """
    hint = "" if login_url == url else " (asks for its token)"
    note(f"{title}: {login_url if sys.stderr.isatty() else url + hint}")
    if browse:
        _open_browser(url)


def _open_browser(url: str) -> None:
    """Open a browser if there is a screen and no program reads the output; failures are ignored."""
    screen = sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not (screen and sys.stdout.isatty() and sys.stderr.isatty()):
        return
    import webbrowser
    from contextlib import suppress
    from threading import Thread

    def show() -> None:
        with suppress(Exception):
            webbrowser.open(url)

    Thread(target=show, daemon=True).start()  # some browsers return only when they are closed
