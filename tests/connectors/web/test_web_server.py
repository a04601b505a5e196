import asyncio
import re
import socket
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from aiohttp import ClientResponse, ClientSession, CookieJar, web

from connectors.web import web_server
from connectors.web.access import TOKEN, is_secret, required_token
from connectors.web.web_server import PAGE_FILES, STATIC, STRANGERS_MAX, WebServer, page_server
from operators.errors import EndpointError, InputError, ParameterError
from tests.waiting import PATIENCE, until

SECRET = "0123456789abcdef"  # noqa: S105 - of tests
BEARER = {"Authorization": f"Bearer {SECRET}"}
PHRASE = "the page needs its token: send the header 'Authorization: Bearer ...', or open /?token=..."
KINDS = {".js": "javascript", ".css": "text/css", ".svg": "image/svg+xml"}


async def answer(_: web.Request) -> web.Response:
    return web.Response(text="text")


async def echo(request: web.Request) -> web.Response:
    body = await request.text()
    if body == "wrong":
        raise InputError("/notes", "is wrong")
    return web.Response(text=body)


@asynccontextmanager
async def served(server: WebServer) -> AsyncGenerator[ClientSession]:
    """Open a server; yield a browser with cookies."""
    await server.open(*PAGE_FILES, web.get("/data", answer), web.post("/notes", echo))
    async with ClientSession(server.url, cookie_jar=CookieJar(unsafe=True)) as session:
        yield session
    await server.close()


def numbers(token: str | None = None, **given: Any) -> WebServer:
    return WebServer(**{"name": "numbers", "host": "127.0.0.1", "port": 0, "token": token, **given})


async def get(session: ClientSession, path: str, **headers: str) -> tuple[int, str, ClientResponse]:
    async with session.get(path, headers=headers, allow_redirects=False) as response:
        return response.status, await response.text(), response


@pytest.mark.parametrize("host", ["::", "192.168.1.5", "rig.lab"])
def test_other_machines_need_a_token_of_the_environment(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert required_token("Page", "127.0.0.1") is None
    with pytest.raises(ParameterError, match=f"host is .*, must be 127.0.0.1, or set {TOKEN}"):
        required_token("Metrics", host)
    monkeypatch.setenv(TOKEN, SECRET)
    assert required_token("Page", host) == SECRET


@pytest.mark.parametrize("token", ["short", "x" * 300, "0123456789 abcdef", "0123456789abcdef\n", "é" * 20])
def test_a_malformed_token_is_rejected_and_not_shown(token: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOKEN, token)
    with pytest.raises(ParameterError) as caught:
        required_token("Page", "127.0.0.1")
    assert token not in str(caught.value)


def test_no_odd_text_is_the_secret() -> None:
    for wrong in (None, "", "ü", "\udcff"):  # aiohttp yields surrogates
        assert not is_secret(wrong, SECRET)


async def test_every_response_has_security_headers_and_a_rebound_host_name_is_rejected() -> None:
    own = "localhost:1", "127.0.0.1:8765", "[fe80::1]:80", "LOCALHOST.", socket.gethostname()
    foreign = "x.y", "evil.example:8765", "", "localhost.evil.example", "a b", "[::1"
    cases = [("/no", "[::1]", 404), *(("/data", host, 200) for host in own)]
    async with served(numbers()) as session:
        for path, host, status in (*cases, *(("/data", host, 421) for host in foreign)):
            found, _, response = await get(session, path, Host=host)
            assert found == status, host
            headers = response.headers
            assert headers["Content-Security-Policy"].startswith("default-src 'self';")
            assert "unsafe" not in headers["Content-Security-Policy"]
            assert headers["X-Content-Type-Options"] == "nosniff"
            assert headers["Referrer-Policy"] == "no-referrer"  # the token may be in the address
            assert headers["Cache-Control"] == "no-store"
            assert "Access-Control-Allow-Origin" not in headers


async def test_only_pages_of_the_server_can_write_and_open_a_web_socket(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(web_server, "_BODY_MAX", 1000)
    server = numbers(SECRET)
    foreign = "http://evil.example", "null", "http://127.0.0.1:1", "http://127.0.0.1.evil.example", ""
    async with served(server) as session:

        async def post(body: bytes, **headers: str) -> int:
            async with session.post("/notes", data=body, headers={**BEARER, **headers}) as response:
                return response.status

        for body, status in ((b"{}", 200), (b"wrong", 400), (b" " * 1001, 413)):
            assert await post(body, Origin=server.url) == status
        assert await post(b"{}") == 403
        for origin in (*foreign, f"{server.url}.evil.example"):
            assert await post(b"{}", Origin=origin) == 403, origin
        assert await post(b"{}", Origin=server.url, Authorization="") == 403
        assert (await get(session, "/notes", **BEARER))[0] == 404
        for origin, status in (server.url, 200), ("", 403), (foreign[0], 403):
            headers = {**BEARER, "Upgrade": "websocket", "Origin": origin}
            assert (await get(session, "/data", **headers))[0] == status


async def test_a_port_in_use_is_an_error_unless_any_port_will_do() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(EndpointError, match=rf":{port}: .* numbers: .*in use; choose another port$"):
            await numbers(port=port).open()
        one, other = (page_server("127.0.0.1", None) for _ in range(2))  # both would like the default port
        async with served(one), served(other):
            assert one.url != other.url


@pytest.mark.parametrize(("host", "port"), [("192.0.2.1", 80), ("nowhere.invalid", 0)])
async def test_a_foreign_address_is_an_error(host: str, port: int) -> None:
    with pytest.raises(EndpointError, match=rf"http://{host}:{port}: cannot serve numbers: .*choose an"):
        await numbers(port=port, host=host).open()


async def test_the_page_and_all_its_files_are_served_and_nothing_else() -> None:
    server = page_server("127.0.0.1", 0)
    async with served(server) as session:
        status, page, response = await get(session, "/")
        assert (status, response.content_type) == (200, "text/html")
        names = re.findall(r'(?:src|href)="([^"]+)"', page)
        for file in STATIC.glob("*.js"):
            names += [f"{name}.js" for name in re.findall(r'from "\./(\w+)\.js"', file.read_text())]
        assert len(names) > 8
        for name in names:
            status, text, response = await get(session, f"/{name}")
            assert (status, bool(text)) == (200, True)
            assert KINDS[Path(name).suffix] in response.content_type
        assert "Leon Sorokin" in (await get(session, "/uplot/LICENSE"))[1]
        for path in ("/../server.py", "/..%2fserver.py", "/static/", "/uplot/../../page.py", "/uplot"):
            reader, writer = await asyncio.open_connection("127.0.0.1", int(server.url.rpartition(":")[2]))
            writer.write(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
            assert (await reader.readline()).split()[1] in {b"403", b"404"}
            writer.close()
            await writer.wait_closed()


async def test_with_a_token_nothing_is_served_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOKEN, SECRET)
    server = page_server("127.0.0.1", 0)
    async with served(server) as session:
        for path in ("/", "/data", "/page.js", "/nothing", "/?token=", f"/?token={SECRET}x"):
            status, text, response = await get(session, path)
            assert (status, response.content_type, text.count("\n")) == (403, "text/plain", 1)
            assert PHRASE in text
            assert "Set-Cookie" not in response.headers
        assert (await get(session, "/data", Authorization=SECRET))[0] == 403
        assert (await get(session, "/data", **BEARER, Host="robot.example"))[1] == "text"
        assert SECRET not in server.url
        status, _, response = await get(session, server.login_url.removeprefix(server.url))
        assert (status, response.headers["Location"]) == (303, "/")
        cookie = response.headers["Set-Cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Lax" in cookie
        assert (await get(session, "/data"))[1] == "text"


async def test_silent_connections_are_limited_and_never_replace_one_with_access() -> None:
    def descriptors() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    async def get_data() -> None:  # on the same connection
        writer.write(f"GET /data HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {SECRET}\r\n\r\n".encode())
        assert b" 200 " in await reader.readline()
        await reader.readuntil(b"\r\n\r\ntext")

    server = numbers(SECRET)
    async with asyncio.timeout(PATIENCE), served(server):
        address = "127.0.0.1", int(server.url.rpartition(":")[2])
        reader, writer = await asyncio.open_connection(*address)
        await get_data()
        before = descriptors()
        silent = await asyncio.gather(*(asyncio.open_connection(*address) for _ in range(3 * STRANGERS_MAX)))
        await until(lambda: descriptors() - before <= len(silent) + STRANGERS_MAX)
        await get_data()
        for _, each in [*silent, (reader, writer)]:
            each.close()
