"""What a rig is called in a replay: not as it is live, so that nobody takes old events for new ones."""

from typing import Final

from operators.errors import ParameterError
from operators.ports import Run

SUFFIX: Final = "-replay"  # a live rig's name does not end so


def replay_name(rig: str) -> str:
    """What a rig is called in a replay; one that is so called already keeps its name.

    >>> replay_name("ur10"), replay_name("ur10-replay")
    ('ur10-replay', 'ur10-replay')
    """
    return rig if is_replay(rig) else rig + SUFFIX


def is_replay(rig: str) -> bool:
    """Whether a rig of this name is a replay.

    >>> is_replay("ur10-replay"), is_replay("ur10")
    (True, False)
    """
    return rig.endswith(SUFFIX)


def name_in(run: Run, owner: str, rig: str) -> str:
    """What a rig is called in a run.

    Raises:
        ParameterError: naming `owner`, if it is live and called as a replay.
    """
    if run.recording is not None:
        return replay_name(rig)
    if is_replay(rig):
        raise ParameterError(
            owner, "rig", rig, f"a name that does not end in {SUFFIX}: so end those of replays"
        )
    return rig
