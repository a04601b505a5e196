import asyncio
import json

from connectors.web.live_page import MessageBuffer


def numbers(messages: list[bytes] | None) -> list[int] | None:
    return None if messages is None else [json.loads(each)[1] for each in messages]


def test_messages_are_returned_from_a_number_on() -> None:
    async def main() -> None:
        buffer = MessageBuffer()
        for k in range(3):
            buffer.put("frame", k)
        assert numbers(await buffer.since(0)) == [0, 1, 2]
        assert numbers(await buffer.since(2)) == [2]
        assert await buffer.since(4) is None  # of another run

    asyncio.run(main())


def test_a_request_waits_for_the_next_message() -> None:
    async def main() -> None:
        buffer = MessageBuffer()
        waiting = [asyncio.create_task(buffer.since(0)) for _ in range(3)]
        await asyncio.sleep(0)
        assert not any(each.done() for each in waiting)
        buffer.put("frame", 7)
        assert [numbers(each) for each in await asyncio.gather(*waiting)] == [[7]] * 3

    asyncio.run(main())


def test_dropped_messages_are_not_returned_in_part_and_memory_is_bounded() -> None:
    async def main() -> None:
        buffer = MessageBuffer(limit=100)
        for k in range(50):
            buffer.put("frame", k)
        assert await buffer.since(0) is None
        kept = numbers(await buffer.since(45))
        assert kept == [45, 46, 47, 48, 49]
        late = await buffer.since(50 - 100 // len(b'["frame",49]'))
        assert late is not None
        assert sum(map(len, late)) <= 100
        buffer.put("frame", "x" * 1000)
        assert await buffer.since(50) is None

    asyncio.run(main())
