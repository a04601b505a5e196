"""What is new in the episodes that sources describe while they go on, and all of them from what was new."""

from collections.abc import Iterable, Mapping, Sequence
from copy import copy

from operators.errors import InputError
from operators.ports import Description, Json
from storage.episodes import listings
from storage.frames import Change


class Following:
    """Looks at the lists of episodes again and again, each time only at what is new.

    A source may change its newest episode, but not when it starts, until it adds the next one; those before
    stay as they are. One that empties its list begins anew.
    """

    def __init__(self, describe: Mapping[str, Description]) -> None:
        """Follow what the sources of a run describe."""
        self._describe = describe
        self._known: dict[str, Change] = {}  # by source, its newest episode only, as it was given

    def look(self) -> list[Change]:
        """What has changed since the changes that `took` was told of.

        Raises:
            InputError: if what a source lists is no list.
        """
        found, listed = list[Change](), listings(self._describe)
        for source in {**self._known, **listed}:
            known = self._known.get(source, Change(source, 0, []))
            change = _since(known, listed.get(source, []))
            if change != known:
                found.append(change)
        return found

    def took(self, changes: Iterable[Change]) -> None:
        """Give these no more."""
        for each in changes:
            newest = each.first + max(len(each.episodes) - 1, 0)
            self._known[each.source] = Change(each.source, newest, each.episodes[-1:])


def put_together(changes: Iterable[Change], where: str) -> dict[str, Description]:
    """What sources described, from all the changes of it.

    Raises:
        InputError: if some are missing.
    """
    found = dict[str, list[Json]]()
    for each in changes:
        listed = found.setdefault(each.source, [])
        if each.first > len(listed):
            raise InputError(where, f"lacks episodes of source {each.source!r} before number {each.first}")
        listed[each.first :] = each.episodes
    return {source: {"episodes": listed} for source, listed in found.items()}


def _since(known: Change, listed: Sequence[Json]) -> Change:
    """The list from the episode on that was its newest; all of it if that is not there any more."""
    first, rest = known.first, listed[known.first :]  # in one go: the list may change meanwhile
    if known.episodes and not (rest and _start(rest[0]) == _start(known.episodes[0])):
        first, rest = 0, listed[:]
    return Change(known.source, first, [*rest[:-1], *map(copy, rest[-1:])])  # the newest may yet change


def _start(episode: Json) -> Json:
    return episode.get("start") if isinstance(episode, dict) else episode
