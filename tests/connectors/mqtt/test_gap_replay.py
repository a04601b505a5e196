import asyncio
import json
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.events import Event
from connectors.fields import Fields
from connectors.mqtt import gap_replay, outbox_log
from connectors.mqtt import outbox as outbox_module
from connectors.mqtt.broker import Message
from connectors.mqtt.gap_replay import GapAnswer, GapReplies, GapRequest
from connectors.mqtt.outbox import Outbox
from connectors.mqtt.outbox_log import Entry, Key
from operators.errors import EndpointError, InputError
from tests.inside import inside
from tests.waiting import until

RIG = "slip/v1/lab/ur10"
REQUEST = GapRequest("ab", 3, 9, f"{RIG}/replay/me")
REPLY = f"{RIG}/replay/me"
DRAFT = Event("lab", "ur10", "0", "", 0, onset=True, time=1, probability=0.9, latency=1.0)


def altered(request: GapRequest | GapAnswer, **values: Any) -> bytes:  # noqa: ANN401 - JSON
    document = {**json.loads(request.encode()), **values}
    return json.dumps({key: value for key, value in document.items() if value is not ...}).encode()


@pytest.mark.parametrize(
    "topic",
    [
        "",
        "elsewhere",
        f"{RIG}/0/event",
        f"{RIG}/replay",
        f"{RIG}/replay/",
        f"{RIG}/replay/request",
        f"{RIG}/replay/event",
        f"{RIG}/replay/a/b",
        f"{RIG}/replay/+",
        f"{RIG}/replay/#",
        f"{RIG}/replay/a\0b",
        f"{RIG}/replay/{'a' * 256}",
        "slip/v1/lab/other/replay/me",
        f"x{RIG}/replay/me",
        None,
        7,
    ],
)
def test_a_reply_topic_must_be_below_the_rigs_replay_topic(topic: object) -> None:
    with pytest.raises(InputError, match=rf"^{RIG}/replay/request: reply_to is .*must be"):
        GapRequest.decode(altered(REQUEST, reply_to=topic), RIG)


@pytest.mark.parametrize(
    ("name", "value"),
    [("epoch", 1), ("from", 0), ("to", 2), ("to", 2**63), ("from", True), ("epoch", ...), ("from", ...)],
)
def test_a_malformed_request_names_its_field(name: str, value: object) -> None:
    with pytest.raises(InputError, match=f"{name} is"):
        GapRequest.decode(altered(REQUEST, **{name: value}), RIG)


@given(st.binary())
def test_any_malformed_payload_raises_an_input_error(payload: bytes) -> None:
    with pytest.raises(InputError):
        GapRequest.decode(payload, RIG)


@pytest.mark.parametrize("missing", [[[2, 4]], [[9, 10]], [[5, 4]], 7, ...])
def test_an_answer_with_missing_beyond_its_range_is_rejected(missing: object) -> None:
    payload = altered(GapAnswer("ab", 3, 9, ()), missing=missing)
    with pytest.raises(InputError, match="missing"):
        GapAnswer.read(Fields.parse(payload, "here"))


def use(
    tmp_path: Path, count: int, body: Callable[[GapReplies, Outbox], Awaitable[None]], keep: int = 1000
) -> None:
    async def main() -> None:
        outbox = Outbox(tmp_path / "outbox", keep=keep, keep_for=1e9)
        await outbox.open()
        try:
            await outbox.append([DRAFT] * count)
            await body(GapReplies(outbox, RIG), outbox)
        finally:
            await outbox.close()

    asyncio.run(main())


async def answers(given: GapReplies) -> list[Message]:
    found = list[Message]()
    while answer := await given.next():
        found += answer
    return found


def read(messages: list[Message]) -> tuple[list[int], list[Any]]:
    """The numbers of the events, and the closing documents."""
    documents = [json.loads(message.payload) for message in messages]
    events = [document["data"]["seq"] for document in documents if "data" in document]
    return events, [document for document in documents if "data" not in document]


def ask(given: GapReplies, epoch: str, first: int, last: int, name: str = "me") -> None:
    given.request(GapRequest(epoch, first, last, f"{RIG}/replay/{name}").encode())


def test_a_reply_has_the_original_events_and_the_closing_document_last(tmp_path: Path) -> None:
    async def body(given: GapReplies, outbox: Outbox) -> None:
        ask(given, outbox.epoch, 3, 40)
        messages = await answers(given)
        assert {(message.topic, message.retain) for message in messages} == {(REPLY, False)}
        events, [closing] = read(messages)
        assert events == list(range(3, 41))
        assert closing == {"epoch": outbox.epoch, "from": 3, "to": 40, "missing": []}
        assert json.loads(messages[-1].payload) == closing
        entries, _ = await outbox.between(outbox.epoch, 3, 3, 1)
        assert messages[0].payload == entries[0].payload

    use(tmp_path, 50, body)


def test_each_request_is_answered_with_one_slice_that_states_its_last_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gap_replay, "SLICE", 4)

    async def body(given: GapReplies, outbox: Outbox) -> None:
        ask(given, outbox.epoch, 11, 50, "a")
        ask(given, outbox.epoch, 1, 2, "b")
        turns = [await given.next() for _ in range(2)]
        assert [turn[0].topic[-1] for turn in turns] == ["a", "b"]
        assert [read(turn)[0] for turn in turns] == [[11, 12, 13, 14], [1, 2]]
        closings = [read(turn)[1][0] for turn in turns]
        assert [(closing["from"], closing["to"], closing["missing"]) for closing in closings] == [
            (11, 14, []),
            (1, 2, []),
        ]
        assert not await given.next()

    use(tmp_path, 50, body)


def test_events_no_longer_kept_are_listed_as_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body(given: GapReplies, outbox: Outbox) -> None:
        for _ in range(4):
            await outbox.append([DRAFT] * 10)
            outbox.acknowledge(await outbox.next(10))
        log = inside(outbox, "_log")
        await until(lambda: log.span(outbox.epoch)[0] == 21 and not inside(outbox, "_unsynced"))
        read_back = log.read

        def damaged(keys: Sequence[Key]) -> list[Entry]:
            return [entry for entry in read_back(keys) if entry.seq != 37]

        monkeypatch.setattr(log, "read", damaged)
        ask(given, outbox.epoch, 1, 10**12)
        events, closings = read(await answers(given))
        assert events == [*range(21, 37), 38, 39, 40]
        [closing] = closings
        assert (closing["from"], closing["to"], closing["missing"]) == (1, 40, [[1, 20], [37, 37]])
        ask(given, "unknown", 3, 9)
        assert read(await answers(given)) == (
            [],
            [{"epoch": "unknown", "from": 3, "to": 9, "missing": [[3, 9]]}],
        )

    monkeypatch.setattr(outbox_module, "ACKNOWLEDGE_EVERY", 0.0)
    monkeypatch.setattr(outbox_log, "SEGMENT_EVENTS", 10)
    use(tmp_path, 0, body, keep=20)


def test_an_unreadable_outbox_does_not_report_events_as_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body(given: GapReplies, outbox: Outbox) -> None:
        async def fail(*_: object) -> None:
            raise EndpointError("disk", "is stuck")

        monkeypatch.setattr(outbox, "between", fail)
        ask(given, outbox.epoch, 1, 3)
        assert not await answers(given)

    use(tmp_path, 5, body)


def test_unused_numbers_get_no_answer(tmp_path: Path) -> None:
    async def body(given: GapReplies, outbox: Outbox) -> None:
        ask(given, outbox.epoch, 6, 9)
        assert not await answers(given)

    use(tmp_path, 5, body)


def test_malformed_requests_are_ignored_and_logged_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def body(given: GapReplies, outbox: Outbox) -> None:
        given.request(b"{}")
        given.request(b"x" * 100_000)
        given.request(GapRequest(outbox.epoch, 1, 2, "elsewhere").encode())
        assert not await given.next()

    use(tmp_path, 5, body)
    assert len(caplog.messages) == 1
    assert caplog.messages[0].startswith(
        f"ignoring malformed gap request (further ones suppressed): {RIG}/replay/request: "
    )


def test_pending_requests_are_bounded_and_unique(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gap_replay, "PENDING_MAX", 3)

    async def body(given: GapReplies, outbox: Outbox) -> None:
        for name in "aabcd":
            ask(given, outbox.epoch, 1, 1, name)
        closings = [message.topic[-1] for message in await answers(given) if b"missing" in message.payload]
        assert closings == ["a", "b", "c"]

    use(tmp_path, 5, body)
