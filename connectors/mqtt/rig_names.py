"""Names of a rig: its topic, and the folder of its outbox."""

import os
import re
from pathlib import Path
from socket import gethostname
from typing import Final
from urllib.parse import quote

from operators.errors import ParameterError

NAME_MAX: Final = 64  # characters of a site or a rig, so that all topics below them fit


def host_rig() -> str:
    """Return the default name of a rig: that of the host, without its domain."""
    return re.sub(r"[^\w.-]", "-", gethostname().partition(".")[0])[:NAME_MAX] or "rig"


def rig_topic(owner: str, site: str, rig: str, *, wildcard: str | None = None) -> str:
    """Return the topic below which a rig publishes; raise ParameterError for a name that is no topic level.

    >>> rig_topic("Mqtt", "lab", "ur10")
    'slip/v1/lab/ur10'

    Raises:
        ParameterError: naming `owner`, if `site` or `rig` is neither one topic level nor `wildcard`.
    """
    for name, part in ("site", site), ("rig", rig):
        if part != wildcard and not is_topic_level(part):
            must_be = f"printable text of at most {NAME_MAX} characters without '/', '+' and '#'"
            raise ParameterError(owner, name, part, must_be)
    return f"slip/v1/{site}/{rig}"


def is_topic_level(name: str) -> bool:
    """Return True if `name` can be a site or a rig."""
    return 0 < len(name) <= NAME_MAX and name.isprintable() and not set(name) & set("/+#")


def outbox_path(site: str, rig: str) -> Path:
    """Return the default outbox of a rig: below XDG_STATE_HOME, else ``~/.local/state``.

    Source: XDG Base Directory Specification 0.8, which ignores a relative XDG_STATE_HOME.

    >>> outbox_path("a-b", "../c").name
    'a%2Db-..%2Fc.outbox'
    """
    name = "-".join(quote(part, safe="").replace("-", "%2D") for part in (site, rig))
    state = Path(os.environ.get("XDG_STATE_HOME", ""))
    if not state.is_absolute():
        state = Path.home() / ".local" / "state"
    return state / "slipflow" / f"{name}.outbox"
