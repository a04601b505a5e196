import asyncio

from connectors.web.viewer import Viewer


def test_messages_are_given_together_in_their_order() -> None:
    async def main() -> None:
        viewer = Viewer()
        viewer.put(b"a")
        viewer.put(b"b")
        assert await viewer.take() == b"ab"
        waiting = asyncio.create_task(viewer.take())
        await asyncio.sleep(0)
        assert not waiting.done()
        viewer.put(b"c")
        assert await waiting == b"c"

    asyncio.run(main())


def test_the_oldest_messages_are_lost_and_counted() -> None:
    async def main() -> None:
        viewer = Viewer(limit=10)
        for k in range(10):
            viewer.put(b"%d23" % k)
        assert await viewer.take() == b"723823923"
        assert viewer.lost == 7

    asyncio.run(main())


def test_a_message_longer_than_all_that_may_wait_is_lost() -> None:
    async def main() -> None:
        viewer = Viewer(limit=2)
        viewer.put(b"123")
        viewer.put(b"4")
        assert await viewer.take() == b"4"
        assert viewer.lost == 1

    asyncio.run(main())


def test_the_end_comes_after_what_waits() -> None:
    async def main() -> None:
        viewer = Viewer()
        viewer.put(b"last")
        viewer.end()
        assert await viewer.take() == b"last"
        assert await viewer.take() is None

    asyncio.run(main())
