"""Showing a flow on the live page: options of the commands that can, and wiring it up."""

import os
import re
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from flows.options import told

if TYPE_CHECKING:
    from collections.abc import Callable

    from flows.graph import Flow
    from flows.node import Node
    from operators.batch import Batch

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

WithPage = Annotated[bool, typer.Option("--page/--no-page", help="Show it live in a browser.")]
Listen = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Where the page is served, which takes SLIPFLOW_PAGE_TOKEN unless that is this machine only. By"
        " default 127.0.0.1:8765, or a free port where that is taken.",
    ),
]
NoBrowser = Annotated[
    bool, typer.Option("--no-browser", help="Print the page's address, but open no browser.")
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
        listen: As ``HOST:PORT``.
        browse: Open a browser where there is a screen.
        opened: Told the address; by default it is printed.

    Raises:
        ParameterError: if the page cannot be served there.
    """
    from connectors import Page
    from operators import Debounce

    host, port = listening(listen)
    parts = [node.part for node in flow.nodes]
    thresholds = [part.threshold for part in parts if isinstance(part, Debounce)]

    def show(url: str) -> None:
        told(f"live page: {url}")
        if browse:
            open_browser(url)

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


def listening(listen: str | None) -> tuple[str, int | None]:
    """Host and port of a page.

    >>> listening(None), listening("0.0.0.0:80"), listening("[::1]:8765")
    (('127.0.0.1', None), ('0.0.0.0', 80), ('::1', 8765))
    """
    if listen is None:
        return "127.0.0.1", None
    match = re.fullmatch(r"(?:\[([0-9A-Fa-f:.]+)\]|([\w.-]+)):([0-9]{1,5})", listen)
    if match is None or int(match[3]) >= 2**16:
        raise typer.BadParameter(f"--listen {listen}: write it as HOST:PORT, such as 0.0.0.0:8765")
    return match[1] or match[2], int(match[3])


def open_browser(url: str) -> None:
    """Show a page where a person sits before a screen; that it cannot be is no error."""
    screen = sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not (screen and sys.stderr.isatty()):
        return
    import webbrowser
    from contextlib import suppress
    from threading import Thread

    def show() -> None:
        with suppress(Exception):
            webbrowser.open(url)

    Thread(target=show, daemon=True).start()  # a browser may take its time to come back
