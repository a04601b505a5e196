"""Sinks that the command line adds to a flow: live page and metrics."""

import os
import sys
import webbrowser
from threading import Thread
from typing import TYPE_CHECKING

from flows.cli.options import parse_address
from flows.cli.terminal import note

if TYPE_CHECKING:
    from flows.graph import Flow
    from flows.graph.node import Node
    from operators.batch import Batch


def add_page(flow: "Flow", listen: str | None = None, *, browse: bool = False) -> None:
    """Add a sink to a flow that shows it on the live page, with the threshold of its first `Debounce`.

    Touch without `Health` gets one, so that the page marks dead, stuck and saturated cells. `listen` is the
    address as ``[HOST:]PORT``; `browse` opens a browser if a person uses this terminal.
    """
    from connectors import Page
    from operators import Debounce, Faults, Motion, Scores, Slips, Touch, Zeroed

    host, port = parse_address("--listen", listen) if listen else ("127.0.0.1", None)
    thresholds = [node.part.threshold for node in flow.nodes if isinstance(node.part, Debounce)]

    def announce(url: str) -> None:
        announce_page("live page", url, page.login_url, browse=browse)

    _watch_cells(flow)
    page = Page(port, host, threshold=thresholds[0] if thresholds else None, opened=announce)
    touch = first_streams(flow, Zeroed) or first_streams(flow, Touch)
    for node in [*touch, *first_streams(flow, Motion, Scores, Slips, Faults)]:
        flow.add_sink(page, node)


def first_streams(flow: "Flow", *kinds: "type[Batch]") -> "list[Node]":
    """Return the streams of these types, for each type and fingertip the first one."""
    found: list[Node] = []
    for kind in kinds:
        fingers = set[int]()
        for node in flow.nodes:
            if node.gives is kind and fingers.isdisjoint(node.fingers):
                fingers.update(node.fingers)
                found.append(node)
    return found


def _watch_cells(flow: "Flow") -> None:
    """Add `Health` to the raw touch of a known range of each fingertip without faults."""
    from operators import Faults, Health, Source, Touch
    from operators.batch import s

    watched = {finger for node in first_streams(flow, Faults) for finger in node.fingers}
    for node in first_streams(flow, Touch):
        fingertip = node.part.fingertip if isinstance(node.part, Source) else None
        if fingertip and fingertip.range and watched.isdisjoint(node.fingers):
            flow.add("faults", Health(clear_after=2 * s), node)


def add_metrics(flow: "Flow", listen: str) -> None:
    """Add a sink to a flow that serves metrics of its run, and of the slips, faults and scores.

    `listen` is the address as ``[HOST:]PORT``.
    """
    from connectors import Metrics
    from operators import Faults, Scores, Slips

    host, port = parse_address("--metrics", listen)
    metrics = Metrics(port, host, opened=lambda url: note(f"metrics: {url}"))
    flow.add("metrics", metrics, *first_streams(flow, Slips, Faults, Scores))


def announce_page(title: str, url: str, login_url: str, *, browse: bool) -> None:
    """Print the address of a page; open a browser if `browse` is set and no program reads the output.

    `login_url` is the URL with the access token. It is printed on a terminal only, never into a log. The
    browser gets the URL without it, because all users of this machine can read the arguments of a process.
    """
    hint = "" if login_url == url else " (asks for its token)"
    note(f"{title}: {login_url if sys.stderr.isatty() else url + hint}")
    screen = sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if browse and screen and sys.stdout.isatty() and sys.stderr.isatty():
        Thread(target=webbrowser.open, args=(url,), daemon=True).start()  # some return only when closed
