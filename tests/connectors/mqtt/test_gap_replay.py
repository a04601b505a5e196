import json
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from itertools import count
from math import inf
from pathlib import Path
from typing import Any

import pytest

from connectors.documents import decode
from connectors.events import Event
from connectors.mqtt import gap_replay, outbox_log
from connectors.mqtt.gap_replay import GapAnswer, GapReplies, GapRequest
from connectors.mqtt.outbox import Outbox
from operators.errors import InputError
from tests.connectors.mqtt.made import EVENT, opened
from tests.inside import inside
from tests.waiting import until

RIG = "slip/v1/lab/ur10"
REQUEST = GapRequest("ab", 3, 9, f"{RIG}/replay/me")
TIMES = count()  # s, longer apart than two answers


def altered(document: GapRequest | GapAnswer, **values: Any) -> bytes:
    changed = {**json.loads(document.encode()), **values}
    return json.dumps({key: value for key, value in changed.items() if value is not ...}).encode()


@asynccontextmanager
async def answering(tmp_path: Path, count: int) -> AsyncGenerator[tuple[GapReplies, Outbox]]:
    """Open an outbox with some events, and answer requests from it."""
    async with opened(Outbox(tmp_path / "outbox")) as outbox:
        await outbox.append([EVENT] * count)
        yield GapReplies(outbox, RIG), outbox


def request(replies: GapReplies, epoch: str, first: int, last: int, name: str = "me") -> None:
    replies.request(GapRequest(epoch, first, last, f"{RIG}/replay/{name}").encode())


async def answer(replies: GapReplies) -> tuple[str, list[int], Any]:
    """The topic of the next answer, the numbers of its events, and its closing document."""
    messages = await replies.next(next(TIMES))
    assert not any(message.retain for message in messages)
    [topic] = {message.topic for message in messages}
    *events, closing = (message.payload for message in messages)
    return (
        topic.removeprefix(f"{RIG}/replay/"),
        [Event.decode(each).seq for each in events],
        json.loads(closing),
    )


@pytest.mark.parametrize(
    "name", ["", "/a", "request", "event", "a/b", "+", "#", "a\0b", "a" * 256, "../../other/replay/me"]
)
def test_a_reply_topic_must_be_below_the_rigs_replay_topic(name: str) -> None:
    assert GapRequest.decode(REQUEST.encode(), RIG) == REQUEST
    for topic in (f"{RIG}/replay/{name}", f"{RIG}{name}", f"x{RIG}/replay/me"):
        with pytest.raises(InputError, match=rf"^{RIG}/replay/request: .*reply_to"):
            GapRequest.decode(altered(REQUEST, reply_to=topic), RIG)


@pytest.mark.parametrize(
    ("name", "value"),
    [("epoch", 1), ("from", 0), ("to", 2), ("to", 2**63), ("from", True), ("epoch", ...), ("from", ...)],
)
def test_a_malformed_request_or_answer_names_its_field(name: str, value: object) -> None:
    closing = GapAnswer("ab", 3, 9, ((3, 4), (7, 7)))
    assert decode(closing.encode(), GapAnswer, "here") == closing
    with pytest.raises(InputError, match=f"{name}`"):
        GapRequest.decode(altered(REQUEST, **{name: value}), RIG)
    with pytest.raises(InputError, match=f"{name}`"):
        decode(altered(closing, **{name: value}), GapAnswer, "here")
    for missing in ([[2, 4]], [[9, 10]], [[5, 4]], 7, ...):
        with pytest.raises(InputError, match="missing"):
            decode(altered(closing, missing=missing), GapAnswer, "here")


async def test_requests_are_answered_in_turn_with_one_slice_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gap_replay, "SLICE", 4)
    async with answering(tmp_path, 50) as (replies, outbox):
        epoch = outbox.epoch
        request(replies, epoch, 11, 50, "a")
        request(replies, epoch, 1, 2, "b")
        for name, slice_ in (("a", [11, 12, 13, 14]), ("b", [1, 2])):
            closing = {"epoch": epoch, "from": slice_[0], "to": slice_[-1], "missing": []}
            assert await answer(replies) == (name, slice_, closing)
        assert not await replies.next(next(TIMES))


async def test_events_that_are_no_longer_kept_are_listed_but_not_those_that_cannot_be_read_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox_log, "SEGMENT_EVENTS", 10)
    monkeypatch.setattr(outbox_log, "SEGMENTS", 2)
    async with answering(tmp_path, 0) as (replies, outbox):
        for _ in range(4):
            await outbox.append([EVENT] * 10)
            outbox.acknowledge(await outbox.next(10))
        await until(lambda: inside(outbox, "_log").span(outbox.epoch)[0] == 21)
        request(replies, outbox.epoch, 1, 10**12)
        closing = {"epoch": outbox.epoch, "from": 1, "to": 40, "missing": [[1, 20]]}
        assert await answer(replies) == ("me", [*range(21, 41)], closing)
        request(replies, "unknown", 3, 9)
        assert (await answer(replies))[2]["missing"] == [[3, 9]]
        request(replies, outbox.epoch, 41, 50)  # not used yet
        assert not await replies.next(next(TIMES))

        async def fail(*_: object) -> None:
            raise OSError("is stuck")

        monkeypatch.setattr(outbox, "between", fail)
        request(replies, outbox.epoch, 1, 3)
        assert not await replies.next(next(TIMES))


async def test_answers_have_a_pause_between_them(tmp_path: Path) -> None:
    async with answering(tmp_path, 5) as (replies, outbox):
        for name in "ab":
            request(replies, outbox.epoch, 1, 1, name)
        assert await replies.next(10.0)
        assert not await replies.next(10.0)
        assert replies.due == 10.0 + gap_replay.PAUSE
        assert await replies.next(replies.due)
        assert replies.due == inf


async def test_pending_requests_are_bounded_and_unique_and_malformed_ones_logged_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(gap_replay, "PENDING_MAX", 3)
    async with answering(tmp_path, 5) as (replies, outbox):
        for malformed in (b"{}", b"x" * 100_000, GapRequest(outbox.epoch, 1, 2, "elsewhere").encode()):
            replies.request(malformed)
        for name in "aabcd":
            request(replies, outbox.epoch, 1, 1, name)
        assert [(await answer(replies))[0] for _ in range(3)] == ["a", "b", "c"]
        assert not await replies.next(next(TIMES))
    [message] = caplog.messages
    assert message.startswith(
        f"ignoring malformed gap request (further ones suppressed): {RIG}/replay/request: "
    )
