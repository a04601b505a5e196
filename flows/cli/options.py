"""Options and arguments that several commands share."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from flows.graph import Flow

Duration = Annotated[
    str | None, typer.Option("--for", metavar="TIME", help="Stop after this time, such as 30s or 5min.")
]
Target = Annotated[
    str,
    typer.Argument(
        metavar="FILE[:FLOW]",
        help="Python file that declares a flow (it is executed), or a shipped flow: live, record, relabel,"
        " lift, demo.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Set a parameter that `check` lists; repeatable."),
]
Seed = Annotated[int, typer.Option(min=0, help="Random seed; the same seed gives identical output.")]
Jobs = Annotated[int | None, typer.Option(min=1, help="Number of processes (default: one per core).")]
Cluster = Annotated[
    str | None,
    typer.Option(
        metavar="URL",
        help="Dask cluster to run on, such as tcp://127.0.0.1:8786; its machines must share all folders.",
    ),
]
Listen = Annotated[
    str | None,
    typer.Option(
        metavar="[HOST:]PORT",
        help="Address of the page (default: 127.0.0.1:8765, or any free port). For other machines set"
        " SLIPFLOW_PAGE_TOKEN, and HOST to 0.0.0.0.",
    ),
]
NoBrowser = Annotated[
    bool, typer.Option("--no-browser", help="Only print the address of the page, open no browser.")
]
Recordings = Annotated[Path, typer.Option(metavar="DIR", help="Dataset to record into.")]
ReportFolder = Annotated[Path, typer.Option(metavar="DIR", help="Folder of the report.")]
Rows = Annotated[str, typer.Option(metavar="N,N", help="Rows of the fingertips on the bus, such as 0,1.")]
DatasetOrSession = Annotated[
    Path, typer.Argument(metavar="DATASET|SESSION", help="Folder of a dataset, or of one of its sessions.")
]


def parse_settings(settings: list[str] | None) -> dict[str, str]:
    """Return the values given with ``--set`` by name.

    >>> parse_settings(["seed=1", "delay=70ms"])
    {'seed': '1', 'delay': '70ms'}
    """
    pairs = [setting.partition("=") for setting in settings or ()]
    for name, equals, _ in pairs:
        if not (name and equals):
            raise typer.BadParameter(f"--set {name}: write it as NAME=VALUE, such as seed=1")
    return {name: value for name, _, value in pairs}


def parse_rows(rows: str) -> tuple[int, ...]:
    """Return the row numbers given with ``--rows``.

    >>> parse_rows("0,1")
    (0, 1)
    """
    try:
        return tuple(int(row) for row in rows.split(","))
    except ValueError:
        raise typer.BadParameter(f"--rows {rows}: must be row numbers such as 0,1") from None


def load_flow(target: str, settings: list[str] | None) -> "Flow":
    """Build the flow that `target` names."""
    from flows.graph.loading import load

    return load(target).flow(parse_settings(settings))


def parse_address(option: str, address: str) -> tuple[str, int]:
    """Return host and port of a server to start; the default host is this machine only.

    >>> [parse_address("--listen", text) for text in ("8765", "0.0.0.0:80", "[::1]:0")]
    [('127.0.0.1', 8765), ('0.0.0.0', 80), ('::1', 0)]
    """
    match = re.fullmatch(r"(?:(?:\[([0-9A-Fa-f:.]+)\]|([\w.-]+)):)?([0-9]{1,5})", address)
    if match is None or int(match[3]) >= 2**16:
        form = "write it as PORT or HOST:PORT, such as 8765 or 0.0.0.0:8765; the highest port is 65535"
        raise typer.BadParameter(f"{option} {address}: {form}")
    return match[1] or match[2] or "127.0.0.1", int(match[3])
