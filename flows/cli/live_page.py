"""Showing a flow on the live page: options of the commands that can, and wiring it up."""

import os
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.listening import listening
from flows.cli.options import told

if TYPE_CHECKING:
    from collections.abc import Callable

    from flows.graph import Flow
    from flows.graph.node import Node
    from operators.batch import Batch

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

WithPage = Annotated[
    bool,
    typer.Option("--page/--no-page", help="Show it live in a browser, which opens where there is a screen."),
]
Listen = Annotated[
    str | None,
    typer.Option(
        metavar="[HOST:]PORT",
        help="Where the page is served, on this machine only unless a host is given, which takes"
        " SLIPFLOW_PAGE_TOKEN. By default 8765, or a free port where that is taken.",
    ),
]
NoBrowser = Annotated[
    bool,
    typer.Option(
        "--no-browser",
        help="Print the page's address, but open no browser; none opens where a program reads the output.",
    ),
]


def add_page(
    flow: "Flow",
    listen: str | None = None,
    *,
    browse: bool = False,
    opened: "Callable[[str], None] | None" = None,
) -> None:
    """Send what the page can show of a flow to a page of its own; tell its address once it is there.

    Of streams of one type the first is shown, touch best zeroed; the threshold is that of the debounce.

    Args:
        flow: Gains a sink.
        listen: As ``[HOST:]PORT``.
        browse: Open a browser where a person sits before a screen.
        opened: Told the address; by default it is printed.

    Raises:
        ParameterError: if the page cannot be served there.
    """
    from connectors import Page
    from operators import Debounce

    host, port = listening("--listen", listen) if listen else ("127.0.0.1", None)
    parts = [node.part for node in flow.nodes]
    thresholds = [part.threshold for part in parts if isinstance(part, Debounce)]

    def show(url: str) -> None:
        invite("live page", url, page.entrance, browse=browse)

    page = Page(port, host, threshold=thresholds[0] if thresholds else None, opened=opened or show)
    for node in shown(flow):
        flow.add_sink(page, node)


def shown(flow: "Flow") -> "list[Node]":
    """The streams of a flow that the page shows."""
    from operators import Faults, Motion, Scores, Slips, Touch, Zeroed

    first: dict[type[Batch] | None, Node] = {}
    for node in flow.nodes:
        first.setdefault(node.gives, node)
    kinds = (Zeroed if Zeroed in first else Touch, Motion, Scores, Slips, Faults)
    return [first[kind] for kind in kinds if kind in first]


def invite(what: str, url: str, entrance: str, *, browse: bool) -> None:
    """Tell where a page is, and have a browser show it where a person sits before a screen.

    Args:
        what: The page, as it is told.
        url: Its address.
        entrance: The same with the token, which a terminal is told, but no log. Nor is a browser given it,
            as everybody on this machine sees the arguments of a process: its page asks for it.
        browse: Open a browser.
    """
    asks = "" if entrance == url else " (asks for its token)"
    told(f"{what}: {entrance if sys.stderr.isatty() else url + asks}")
    if browse:
        open_browser(url)


def open_browser(url: str) -> None:
    """Show a page where a person sits before a screen; that it cannot be is no error."""
    screen = sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not (screen and sys.stdout.isatty() and sys.stderr.isatty()):  # else a program reads what is printed
        return
    import webbrowser
    from contextlib import suppress
    from threading import Thread

    def show() -> None:
        with suppress(Exception):
            webbrowser.open(url)

    Thread(target=show, daemon=True).start()  # a browser may take its time to come back
