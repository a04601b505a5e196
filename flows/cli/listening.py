"""Where a command serves something to others, as a person writes it."""

import re

import typer


def listening(option: str, given: str) -> tuple[str, int]:
    """Host and port that an option names; without a host, this machine only.

    >>> [listening("--listen", given) for given in ("8765", "0.0.0.0:80", "[::1]:0")]
    [('127.0.0.1', 8765), ('0.0.0.0', 80), ('::1', 0)]
    """
    match = re.fullmatch(r"(?:(?:\[([0-9A-Fa-f:.]+)\]|([\w.-]+)):)?([0-9]{1,5})", given)
    if match is None or int(match[3]) >= 2**16:
        ways = "write it as PORT or HOST:PORT, such as 8765 or 0.0.0.0:8765"
        raise typer.BadParameter(f"{option} {given}: {ways}; ports end at 65535")
    return match[1] or match[2] or "127.0.0.1", int(match[3])
