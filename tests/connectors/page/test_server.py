import asyncio
import re
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from aiohttp import ClientResponse, ClientSession, CookieJar, web

from connectors.page import server as module
from connectors.page.access import Access
from connectors.page.server import PageServer
from operators.errors import EndpointError

SECRET = "0123456789abcdef"  # noqa: S105 - of tests
STATIC = Path(module.__file__).parent / "static"


async def answer(_: web.Request) -> web.Response:
    return web.Response(text="felt")


def served(use: Callable[[ClientSession, str], Awaitable[None]], token: str | None = None) -> None:
    """A browser with cookies at a server."""

    async def main() -> None:
        server = PageServer("127.0.0.1", 0, Access(token))
        await server.open({"/data": answer})
        async with ClientSession(cookie_jar=CookieJar(unsafe=True)) as session:
            await use(session, server.url)
        await server.close()

    asyncio.run(main())


async def get(session: ClientSession, url: str, host: str | None = None) -> tuple[int, str, ClientResponse]:
    headers = {"Host": host} if host else {}
    async with session.get(url, headers=headers, allow_redirects=False) as response:
        return response.status, await response.text(), response


def test_the_page_and_all_that_it_names_is_served() -> None:
    async def use(session: ClientSession, url: str) -> None:
        status, page, response = await get(session, f"{url}/")
        assert (status, response.content_type) == (200, "text/html")
        names = re.findall(r'(?:src|href)="([^"]+)"', page)
        names += [
            f"{name}.js"
            for path in STATIC.glob("*.js")
            for name in re.findall(r'from "\./(\w+)\.js"', path.read_text())
        ]
        assert len(names) > 8
        for name in names:
            status, text, response = await get(session, f"{url}/{name}")
            assert status == 200
            assert text
            kinds = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
            assert response.content_type == kinds[Path(name).suffix]
        assert (await get(session, f"{url}/data"))[1] == "felt"
        assert "Leon Sorokin" in (await get(session, f"{url}/uplot/LICENSE"))[1]

    served(use)


@pytest.mark.parametrize(
    "path", ["/../server.py", "/..%2fserver.py", "/static/", "/uplot/../../page.py", "/uplot"]
)
def test_nothing_else_is_served(path: str) -> None:
    async def use(_: ClientSession, url: str) -> None:
        port = int(url.rpartition(":")[2])
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
        assert b" 404 " in await reader.readline()
        writer.close()
        await writer.wait_closed()

    served(use)


def test_every_answer_forbids_what_comes_from_elsewhere() -> None:
    async def use(session: ClientSession, url: str) -> None:
        for path in ("/", "/data", "/nothing"):
            headers = (await get(session, url + path))[2].headers
            assert headers["Content-Security-Policy"].startswith("default-src 'self';")
            assert "unsafe" not in headers["Content-Security-Policy"]
            assert headers["X-Content-Type-Options"] == "nosniff"
            assert headers["Referrer-Policy"] == "no-referrer"  # the token may be in the address
            assert headers["Cache-Control"] == "no-store"
            assert "Access-Control-Allow-Origin" not in headers

    served(use)


def test_a_name_made_to_lead_here_is_refused() -> None:
    async def use(session: ClientSession, url: str) -> None:
        for path in ("/", "/data"):
            assert (await get(session, url + path, "evil.example"))[0] == 421
            assert (await get(session, url + path, "localhost:1"))[0] == 200

    served(use)


def test_with_a_token_only_its_cookie_opens() -> None:
    async def use(session: ClientSession, url: str) -> None:
        for path in ("/", "/data", "/page.js", "/nothing", "/?token=wrong", "/?token=", f"/?token={SECRET}x"):
            status, text, response = await get(session, url + path)
            assert status == 401
            assert "token" in text
            assert "Set-Cookie" not in response.headers
        status, _, response = await get(session, f"{url}/?token={SECRET}")
        assert (status, response.headers["Location"]) == (303, "/")
        cookie = response.headers["Set-Cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Lax" in cookie
        assert SECRET not in cookie
        assert (await get(session, f"{url}/data"))[1] == "felt"

    served(use, SECRET)


def test_a_place_that_is_not_ours_is_refused() -> None:
    with pytest.raises(EndpointError, match=r"http://192\.0\.2\.1:80: cannot serve the page there"):
        asyncio.run(PageServer("192.0.2.1", 80, Access(SECRET)).open({}))
    with pytest.raises(EndpointError, match="cannot serve the page there"):
        asyncio.run(PageServer("nowhere.invalid", 0, Access(SECRET)).open({}))
