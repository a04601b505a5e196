import asyncio

from aiohttp import ClientSession

from connectors.web.session_page import SessionCurves
from connectors.web.session_requests import SessionPage, session_requests
from connectors.web.web_server import page_server
from operators.batch import ms, s
from operators.ports import Run
from tests.connectors.web.reading import slip, touched
from tests.waiting import PATIENCE


def test_the_server_returns_the_session_and_any_window(run: Run) -> None:
    async def main() -> None:
        recorded = SessionCurves()
        await recorded.open(run)
        for k in range(10):
            await recorded.write(touched(90 * s + k * 10 * ms, -k))
        await recorded.write(slip(90 * s + 50 * ms, 1))
        await recorded.close()
        server = page_server("127.0.0.1", 0)
        await server.open(*session_requests([SessionPage(recorded)]))
        url = server.url
        async with asyncio.timeout(PATIENCE), ClientSession() as session:
            async with session.get(f"{url}/about.json") as response:
                about = await response.json()
            assert (about["mode"], about["session"], about["length"]) == ("recorded", "run1", 90)
            async with session.get(f"{url}/window?begin=20&end=40&at=25&columns=99") as response:
                window = await response.json()
                assert window["touch"]["0"]["t"] == [20, 30, 40]
                assert window["at"]["touch"]["0"] == {"t": [20], "v": [[-2] * 6], "zeroed": True}
            for wrong in (
                "",
                "?begin=1&end=2&at=2",
                "?begin=1&columns=9&at=2",
                "?begin=a&end=2&columns=9&at=2",
                "?begin=nan&end=nan&columns=9&at=2",
                "?begin=0&end=1&columns=9&at=nan",
                "?begin=2&end=1&columns=9&at=2",
                "?begin=0&end=1e300&columns=9&at=2",
                "?begin=0&end=1&columns=0&at=2",
                "?begin=0&end=1&columns=1e9&at=2",
                "?begin=0&end=1&columns=99999&at=2",
            ):
                async with session.get(f"{url}/window{wrong}") as response:
                    assert response.status == 400, wrong
                    assert "begin=MS" in await response.text()
        await server.close()

    asyncio.run(main())
