import asyncio
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from connectors.events import Event
from connectors.mqtt import gap_answers
from connectors.mqtt.gap_answers import GapAnswers
from connectors.mqtt.gap_request import GapRequest
from connectors.mqtt.message import Message
from connectors.mqtt.outbox import Outbox
from operators.errors import EndpointError
from tests.inside import inside

RIG = "slip/v1/lab/rig"
REPLY = f"{RIG}/replay/me"
DRAFT = Event("lab", "rig", "0", "", 0, onset=True, time=1, probability=0.9, latency=1.0)


def use(tmp_path: Path, count: int, body: Callable[[GapAnswers, Outbox], Awaitable[None]]) -> None:
    async def main() -> None:
        outbox = Outbox(tmp_path / "o.sqlite", keep=1000, keep_for=1e9)
        await outbox.open()
        try:
            await outbox.append([DRAFT] * count)
            await body(GapAnswers(outbox, RIG), outbox)
        finally:
            await outbox.close()

    asyncio.run(main())


async def answers(given: GapAnswers) -> list[Message]:
    found = list[Message]()
    while given:
        found += await given.next()
    return found


def read(messages: list[Message]) -> tuple[list[int], list[Any]]:
    """The numbers of the events, and the closing documents."""
    documents = [json.loads(message.payload) for message in messages]
    events = [document["data"]["seq"] for document in documents if "data" in document]
    return events, [document for document in documents if "data" not in document]


def ask(given: GapAnswers, epoch: str, first: int, last: int, name: str = "me") -> None:
    given.ask(GapRequest(epoch, first, last, f"{RIG}/replay/{name}").encode())


def test_events_come_as_they_were_and_the_closing_document_last(tmp_path: Path) -> None:
    async def body(given: GapAnswers, outbox: Outbox) -> None:
        ask(given, outbox.epoch, 3, 40)
        messages = await answers(given)
        assert {(message.topic, message.retain, message.qos) for message in messages} == {(REPLY, False, 1)}
        events, [closing] = read(messages)
        assert events == list(range(3, 41))
        assert closing == {"epoch": outbox.epoch, "from": 3, "to": 40, "missing": []}
        assert json.loads(messages[-1].payload) == closing
        entries, _ = await outbox.between(outbox.epoch, 3, 3, 1)
        assert messages[0].payload == entries[0].payload

    use(tmp_path, 50, body)


def test_a_turn_is_short_and_the_requests_take_turns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gap_answers, "SLICE", 4)

    async def body(given: GapAnswers, outbox: Outbox) -> None:
        ask(given, outbox.epoch, 1, 9, "a")
        ask(given, outbox.epoch, 1, 2, "b")
        turns = [await given.next() for _ in range(4)]
        assert [len(turn) for turn in turns] == [4, 3, 4, 2]
        assert [turn[0].topic[-1] for turn in turns] == ["a", "b", "a", "a"]
        assert not await given.next()

    use(tmp_path, 50, body)


def test_an_answer_is_a_page_and_says_how_far_it_reaches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gap_answers, "PAGE", 20)

    async def body(given: GapAnswers, outbox: Outbox) -> None:
        ask(given, outbox.epoch, 11, 50)
        events, [closing] = read(await answers(given))
        assert events == list(range(11, 31))
        assert (closing["from"], closing["to"]) == (11, 30)

    use(tmp_path, 50, body)


def test_what_is_no_longer_kept_is_said_to_be_missing_however_much_it_is(tmp_path: Path) -> None:
    async def body(given: GapAnswers, outbox: Outbox) -> None:
        outbox.acknowledge(await outbox.next(500))
        outbox.acknowledge(await outbox.next(500))
        await vars(Outbox)["_note"](outbox)
        inside(outbox, "_file").prune(40, 0)
        inside(outbox, "_file", "_db").execute("DELETE FROM events WHERE id IN (570, 571)")
        inside(outbox, "_memory").clear()
        ask(given, outbox.epoch, 1, 10**12)
        events, [closing] = read(await answers(given))
        assert events == [seq for seq in range(561, 601) if seq not in (570, 571)]
        assert (closing["to"], closing["missing"]) == (600, [[1, 560], [570, 571]])
        ask(given, "unknown", 3, 9)
        assert read(await answers(given)) == (
            [],
            [{"epoch": "unknown", "from": 3, "to": 9, "missing": [[3, 9]]}],
        )

    use(tmp_path, 600, body)


def test_what_cannot_be_read_now_is_not_said_to_be_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body(given: GapAnswers, outbox: Outbox) -> None:
        async def fail(*_: object) -> None:
            raise EndpointError("disk", "is stuck")

        monkeypatch.setattr(outbox, "between", fail)
        ask(given, outbox.epoch, 1, 3)
        assert not await answers(given)

    use(tmp_path, 5, body)


def test_numbers_that_were_never_given_get_no_answer(tmp_path: Path) -> None:
    async def body(given: GapAnswers, outbox: Outbox) -> None:
        ask(given, outbox.epoch, 6, 9)
        assert not await answers(given)

    use(tmp_path, 5, body)


def test_malformed_requests_are_ignored_and_logged_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def body(given: GapAnswers, outbox: Outbox) -> None:
        given.ask(b"{}")
        given.ask(b"x" * 100_000)
        given.ask(GapRequest(outbox.epoch, 1, 2, "elsewhere").encode())
        assert not given

    use(tmp_path, 5, body)
    assert len(caplog.messages) == 1
    assert caplog.messages[0].startswith(f"ignored, as all that are like it: {RIG}/replay/request: ")


def test_only_so_many_requests_wait_and_each_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gap_answers, "REQUESTS", 3)

    async def body(given: GapAnswers, outbox: Outbox) -> None:
        for name in "aabcd":
            ask(given, outbox.epoch, 1, 1, name)
        closings = [message.topic[-1] for message in await answers(given) if b"missing" in message.payload]
        assert closings == ["a", "b", "c"]

    use(tmp_path, 5, body)
