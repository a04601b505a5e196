import asyncio
import json

from aiohttp import ClientSession

from connectors.web.session_curves import SessionCurves
from connectors.web.session_page import SessionPage
from connectors.web.web_server import page_server
from operators.batch import ms, s
from operators.ports import Run
from tests.connectors.web.reading import slip, touched
from tests.waiting import PATIENCE

WRONG = (
    "/window",
    "/window?begin=1&end=2&at=2",
    "/window?begin=a&end=2&columns=9&at=2",
    "/window?begin=nan&end=nan&columns=9&at=2",
    "/window?begin=2&end=1&columns=9&at=2",
    "/window?begin=0&end=1e300&columns=9&at=2",
    "/window?begin=0&end=1&columns=0&at=2",
    "/window?begin=0&end=1&columns=99999&at=2",
    "/events?threshold=0",
    "/events?threshold=x",
)


def test_the_server_returns_the_session_and_any_window(run: Run) -> None:
    async def main() -> None:
        recorded = SessionCurves()
        await recorded.open(run)
        for k in range(10):
            await recorded.write(touched(90 * s + k * 10 * ms, -k))
        await recorded.write(slip(90 * s + 50 * ms, 1))
        await recorded.close()
        server, page = page_server("127.0.0.1", 0), SessionPage(recorded)
        await server.open(*page.routes)
        async with asyncio.timeout(PATIENCE), ClientSession() as session:

            async def get(path: str) -> tuple[int, str]:
                async with session.get(server.url + path) as response:
                    return response.status, await response.text()

            about = json.loads((await get("/about.json"))[1])
            assert (about["mode"], about["session"], about["length"]) == ("recorded", "run1", 90)
            window = json.loads((await get("/window?begin=20&end=40&at=25&columns=99"))[1])
            assert window["rows"]["touch"]["0"]["t"] == [20, 30, 40]
            assert window["at"]["rows"]["touch"]["0"] == {"t": [20], "v": [[-2] * 6]}
            assert await get("/events?threshold=0.5") == (200, "[]")
            for wrong in WRONG:
                status, text = await get(wrong)
                assert (status, "must be ?" in text) == (400, True), wrong
        await server.close()

    asyncio.run(main())
