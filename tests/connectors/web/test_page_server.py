import asyncio
import re
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from aiohttp import ClientResponse, ClientSession, CookieJar, web

from connectors.web import page_server as module
from connectors.web.page_server import PageServer

SECRET = "0123456789abcdef"  # noqa: S105 - of tests
STATIC = Path(module.__file__).parent / "static"


async def answer(_: web.Request) -> web.Response:
    return web.Response(text="felt")


def served(use: Callable[[ClientSession, str], Awaitable[None]], token: str | None = None) -> None:
    """A browser with cookies at a server."""

    async def main() -> None:
        server = PageServer("127.0.0.1", 0, token)
        await server.open({"/data": answer})
        async with ClientSession(cookie_jar=CookieJar(unsafe=True)) as session:
            await use(session, server.url)
        await server.close()

    asyncio.run(main())


async def get(session: ClientSession, url: str, **headers: str) -> tuple[int, str, ClientResponse]:
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


def test_people_without_the_token_are_asked_for_it_and_programs_get_a_line() -> None:
    async def use(session: ClientSession, url: str) -> None:
        browser = "text/html,application/xhtml+xml,*/*;q=0.8"
        for path in ("/", "/locked.html", "/nothing"):
            status, page, response = await get(session, url + path, Accept=browser)
            assert (status, response.content_type) == (401, "text/html")
            assert "SLIPFLOW_PAGE_TOKEN" in page
            assert '<p id="wrong" hidden>' in page
        for name in re.findall(r'(?:src|href)="(/[^"]+)"', page):
            status, text, _ = await get(session, url + name)
            assert status == 200
            assert text
        assert '<p id="wrong">' in (await get(session, f"{url}/?token=wrong", Accept=browser))[1]
        for program in ("text/event-stream", "application/json", "*/*"):
            status, text, response = await get(session, f"{url}/data", Accept=program)
            assert (status, response.content_type, text.count("\n")) == (401, "text/plain", 1)

    served(use, SECRET)
