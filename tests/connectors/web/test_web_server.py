import asyncio
import re
import resource
import socket
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest
from aiohttp import ClientResponse, ClientSession, CookieJar, web

from connectors.web import web_server
from connectors.web.access import Access
from connectors.web.web_server import STATIC, STRANGERS_MAX, WebServer, page_server
from operators.errors import EndpointError, InputError
from tests.waiting import PATIENCE, until

SECRET = "0123456789abcdef"  # noqa: S105 - of tests


async def answer(_: web.Request) -> web.Response:
    return web.Response(text="text")


async def echo(request: web.Request) -> web.Response:
    body = await request.text()
    if body == "wrong":
        raise InputError("/notes", "is wrong")
    return web.Response(text=body)


@asynccontextmanager
async def served(access: Access) -> AsyncGenerator[tuple[ClientSession, str]]:
    """A browser with cookies at a server."""
    server = WebServer("127.0.0.1", 0, access, "numbers")
    await server.open(web.get("/data", answer), web.post("/notes", echo))
    async with ClientSession(cookie_jar=CookieJar(unsafe=True)) as session:
        yield session, server.url
    await server.close()


async def get(session: ClientSession, url: str, **headers: str) -> tuple[int, str, ClientResponse]:
    async with session.get(url, headers=headers, allow_redirects=False) as response:
        return response.status, await response.text(), response


def test_every_response_has_security_headers() -> None:
    async def main() -> None:
        async with served(Access()) as (session, url):
            for path in ("/data", "/nothing"):
                headers = (await get(session, url + path))[2].headers
                assert headers["Content-Security-Policy"].startswith("default-src 'self';")
                assert "unsafe" not in headers["Content-Security-Policy"]
                assert headers["X-Content-Type-Options"] == "nosniff"
                assert headers["Referrer-Policy"] == "no-referrer"  # the token may be in the address
                assert headers["Cache-Control"] == "no-store"
                assert "Access-Control-Allow-Origin" not in headers

    asyncio.run(main())


def test_only_pages_of_the_server_can_write(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web_server, "_BODY_MAX", 1000)
    json = {"Content-Type": "application/json"}

    async def main() -> None:
        async with served(Access()) as (session, url):

            async def post(body: bytes, headers: dict[str, str]) -> int:
                async with session.post(f"{url}/notes", data=body, headers={**json, **headers}) as response:
                    return response.status

            own = {"Origin": url}
            assert await post(b"{}", own) == 200
            assert await post(b"wrong", own) == 400
            assert await post(b"{}", {}) == 403  # no origin
            for origin in ("http://evil.example", "null", "http://127.0.0.1:1", f"{url}.evil.example", ""):
                assert await post(b"{}", {"Origin": origin}) == 403, origin
            assert await post(b"{}", {"Host": "evil.example", "Origin": "http://evil.example"}) == 421
            assert (await get(session, f"{url}/notes"))[0] == 405
            assert await post(b" " * 1001, own) == 413

    asyncio.run(main())


def test_a_write_needs_the_token() -> None:
    async def main() -> None:
        async with served(Access(SECRET)) as (session, url):
            headers = {"Content-Type": "application/json", "Origin": url}
            response = await session.post(f"{url}/notes", data=b"{}", headers=headers)
            assert response.status == 401
            headers["Authorization"] = f"Bearer {SECRET}"
            response = await session.post(f"{url}/notes", data=b"{}", headers=headers)
            assert response.status == 200

    asyncio.run(main())


def test_a_rebound_host_name_is_rejected() -> None:
    async def main() -> None:
        async with served(Access()) as (session, url):
            assert (await get(session, f"{url}/data", Host="evil.example"))[0] == 421
            assert (await get(session, f"{url}/data", Host="localhost:1"))[0] == 200

    asyncio.run(main())


def test_without_the_token_the_response_has_a_remedy() -> None:
    async def main() -> None:
        async with served(Access(SECRET)) as (session, url):
            status, text, _ = await get(session, f"{url}/data")
            assert status == 401
            assert text.startswith(
                "Access to numbers needs its token: append /?token=... to the address, or "
            )
            assert (await get(session, f"{url}/data", Authorization=f"Bearer {SECRET}"))[1] == "text"

    asyncio.run(main())


def test_the_login_url_has_the_token_and_the_url_has_not() -> None:
    async def main() -> None:
        server = WebServer("127.0.0.1", 0, Access(SECRET), "numbers")
        await server.open(web.get("/data", answer))
        async with ClientSession(cookie_jar=CookieJar(unsafe=True)) as session:
            assert SECRET not in server.url
            assert (await get(session, server.login_url))[0] == 303
            assert (await get(session, f"{server.url}/data"))[1] == "text"
        await server.close()

    asyncio.run(main())


def test_a_port_in_use_is_an_error_unless_any_port_will_do() -> None:
    async def main() -> None:
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
            with pytest.raises(EndpointError) as caught:
                await WebServer("127.0.0.1", port, Access(), "numbers").open()
            assert str(caught.value) == (
                f"http://127.0.0.1:{port}: cannot serve numbers: Address already in use; choose another port"
            )
            server = WebServer("127.0.0.1", port, Access(), "numbers", any_port=True)
            await server.open()
            assert server.url.startswith("http://127.0.0.1:")
            assert server.url != f"http://127.0.0.1:{port}"
            await server.close()

    asyncio.run(main())


@pytest.mark.parametrize(("host", "port"), [("192.0.2.1", 80), ("nowhere.invalid", 0)])
def test_a_foreign_address_is_an_error(host: str, port: int) -> None:
    with pytest.raises(EndpointError, match=rf"http://{host}:{port}: cannot serve numbers: .*choose an"):
        asyncio.run(WebServer(host, port, Access(), "numbers", any_port=True).open())


def page_served(use: Callable[[ClientSession, str], Awaitable[None]], token: str | None = None) -> None:
    """A browser with cookies at a server."""

    async def main() -> None:
        server = page_server("127.0.0.1", 0, token)
        await server.open(web.get("/data", answer))
        async with ClientSession(cookie_jar=CookieJar(unsafe=True)) as session:
            await use(session, server.url)
        await server.close()

    asyncio.run(main())


def test_the_page_and_all_its_files_are_served() -> None:
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
            kinds = {".js": "javascript", ".css": "text/css", ".svg": "image/svg+xml"}
            assert kinds[Path(name).suffix] in response.content_type
        assert (await get(session, f"{url}/data"))[1] == "text"
        assert "Leon Sorokin" in (await get(session, f"{url}/uplot/LICENSE"))[1]

    page_served(use)


@pytest.mark.parametrize(
    "path", ["/../server.py", "/..%2fserver.py", "/static/", "/uplot/../../page.py", "/uplot"]
)
def test_nothing_else_is_served(path: str) -> None:
    async def use(_: ClientSession, url: str) -> None:
        port = int(url.rpartition(":")[2])
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
        assert (await reader.readline()).split()[1] in {b"403", b"404"}
        writer.close()
        await writer.wait_closed()

    page_served(use)


def test_with_a_token_only_its_cookie_is_accepted() -> None:
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
        assert (await get(session, f"{url}/data"))[1] == "text"

    page_served(use, SECRET)


def test_browsers_get_a_token_form_and_programs_a_line_of_text() -> None:
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

    page_served(use, SECRET)


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_silent_connections_are_limited_and_never_replace_one_with_access() -> None:
    async def main() -> None:
        server = WebServer("127.0.0.1", 0, Access(SECRET), "numbers")
        await server.open(web.get("/data", answer))
        address = "127.0.0.1", int(server.url.rpartition(":")[2])
        reader, writer = await asyncio.open_connection(*address)

        async def get_data() -> None:  # on the same connection
            writer.write(f"GET /data HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {SECRET}\r\n\r\n".encode())
            assert b" 200 " in await reader.readline()
            await reader.readuntil(b"\r\n\r\ntext")

        async with asyncio.timeout(PATIENCE):
            await get_data()
            before = descriptors()
            silent = [await asyncio.open_connection(*address) for _ in range(5 * STRANGERS_MAX)]
            for stranger, _ in silent[:-STRANGERS_MAX]:
                with suppress(ConnectionResetError):
                    assert await stranger.read() == b""  # closed by the server
            assert descriptors() - before <= len(silent) + STRANGERS_MAX
            assert not silent[-1][0].at_eof()
            await get_data()
        for _, each in [*silent, (reader, writer)]:
            each.close()
        await server.close()

    asyncio.run(main())


def test_an_eighth_of_the_file_descriptors_is_used_by_strangers_at_most(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def few(_: int) -> tuple[int, int]:
        return 32, 32

    monkeypatch.setattr(resource, "getrlimit", few)

    async def main() -> None:
        server = WebServer("127.0.0.1", 0, Access(), "numbers")
        await server.open(web.get("/data", answer))
        before = descriptors()
        address = "127.0.0.1", int(server.url.rpartition(":")[2])
        silent = await asyncio.gather(*(asyncio.open_connection(*address) for _ in range(12)))  # at once
        await until(lambda: descriptors() - before == len(silent) + 4)
        for _, writer in silent:
            writer.close()
        await server.close()

    asyncio.run(main())
