import asyncio
import socket
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import pytest
from aiohttp import ClientResponse, ClientSession, CookieJar, web

from connectors.web.access import Access
from connectors.web.http_server import WebServer
from operators.errors import EndpointError

SECRET = "0123456789abcdef"  # noqa: S105 - of tests


async def answer(_: web.Request) -> web.Response:
    return web.Response(text="felt")


@asynccontextmanager
async def served(access: Access) -> AsyncGenerator[tuple[ClientSession, str]]:
    """A browser with cookies at a server."""
    server = WebServer("127.0.0.1", 0, access, "numbers")
    await server.open({"/data": answer})
    async with ClientSession(cookie_jar=CookieJar(unsafe=True)) as session:
        yield session, server.url
    await server.close()


async def get(session: ClientSession, url: str, **headers: str) -> tuple[int, str, ClientResponse]:
    async with session.get(url, headers=headers, allow_redirects=False) as response:
        return response.status, await response.text(), response


def test_every_answer_forbids_what_comes_from_elsewhere() -> None:
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


def test_a_name_made_to_lead_here_is_refused() -> None:
    async def main() -> None:
        async with served(Access()) as (session, url):
            assert (await get(session, f"{url}/data", Host="evil.example"))[0] == 421
            assert (await get(session, f"{url}/data", Host="localhost:1"))[0] == 200

    asyncio.run(main())


def test_without_the_token_a_line_says_what_to_do() -> None:
    async def main() -> None:
        async with served(Access(SECRET)) as (session, url):
            status, text, _ = await get(session, f"{url}/data")
            assert status == 401
            assert text == (
                "Only those see numbers who have its token: open its address with /?token=... behind it.\n"
            )

    asyncio.run(main())


def test_the_entrance_has_the_token_and_the_address_has_not() -> None:
    async def main() -> None:
        server = WebServer("127.0.0.1", 0, Access(SECRET), "numbers")
        await server.open({"/data": answer})
        async with ClientSession(cookie_jar=CookieJar(unsafe=True)) as session:
            assert SECRET not in server.url
            assert (await get(session, server.entrance))[0] == 303
            assert (await get(session, f"{server.url}/data"))[1] == "felt"
        await server.close()

    asyncio.run(main())


def test_a_port_that_is_taken_is_told_unless_a_spare_one_may_be() -> None:
    async def main() -> None:
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
            with pytest.raises(EndpointError) as caught:
                await WebServer("127.0.0.1", port, Access(), "numbers").open({})
            assert str(caught.value) == (
                f"http://127.0.0.1:{port}: cannot serve numbers there: Address already in use; "
                "choose another port"
            )
            server = WebServer("127.0.0.1", port, Access(), "numbers", spare=True)
            await server.open({})
            assert server.url.startswith("http://127.0.0.1:")
            assert server.url != f"http://127.0.0.1:{port}"
            await server.close()

    asyncio.run(main())


@pytest.mark.parametrize(("host", "port"), [("192.0.2.1", 80), ("nowhere.invalid", 0)])
def test_a_place_that_is_not_ours_is_refused(host: str, port: int) -> None:
    with pytest.raises(
        EndpointError, match=rf"http://{host}:{port}: cannot serve numbers there: .*choose an"
    ):
        asyncio.run(WebServer(host, port, Access(), "numbers", spare=True).open({}))
