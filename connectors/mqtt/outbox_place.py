"""Where the outbox of a rig is, and who may use it."""

import os
from hashlib import sha256
from pathlib import Path
from secrets import token_hex
from urllib.parse import quote

from connectors.mqtt.lock import lock_beside
from connectors.mqtt.replay_name import SUFFIX
from operators.errors import EndpointError


def default_path(site: str, rig: str) -> Path:
    """Where the outbox of a rig is: below XDG_STATE_HOME, else ``~/.local/state``.

    >>> default_path("a-b", "../c").name
    'a%2Db-..%2Fc.sqlite'
    """
    name = "-".join(quote(part, safe="").replace("-", "%2D") for part in (site, rig))
    if len(name) > 200:  # noqa: PLR2004 - file names end at 255 bytes
        name = sha256(name.encode()).hexdigest()
    state = Path(os.environ.get("XDG_STATE_HOME", ""))
    if not state.is_absolute():  # the specification has it ignored then
        state = Path.home() / ".local" / "state"
    return state / "slipflow" / f"{name}.sqlite"


def of_replays(path: Path) -> Path:
    """Where the outbox of a rig's replays is: beside the rig's own.

    >>> of_replays(Path("lab/ur10.sqlite")).as_posix()
    'lab/ur10-replay.sqlite'
    """
    return path.with_stem(path.stem + SUFFIX)


def lock(path: Path) -> int:
    """Make sure that nobody else uses an outbox; gives the descriptor to be closed.

    Raises:
        EndpointError: if somebody does.
        OSError: if the folder cannot be made or written.
    """
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    try:
        return lock_beside(path)
    except BlockingIOError:
        reason = "is in use: two runs may not publish as one rig; name another rig or outbox"
        raise EndpointError(str(path), reason) from None


def boot() -> str:
    """Which start of the system this is; where that is not known, something new each time.

    >>> boot() == boot()
    True
    """
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return token_hex(16)
