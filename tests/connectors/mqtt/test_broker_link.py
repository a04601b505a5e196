import asyncio
import signal
import threading
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest
from aiomqtt import Client

from connectors.mqtt import broker_link as module
from connectors.mqtt.broker import CA, Broker, Message
from connectors.mqtt.broker_link import connect
from operators.errors import EndpointError
from tests.connectors.mqtt.broker_process import TestBroker, deliver
from tests.inside import inside
from tests.waiting import PATIENCE

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]


async def use(broker: Broker | str, *topics: str) -> None:
    """Connect, publish to topics, leave."""
    link = await connect(Broker.parse(broker) if isinstance(broker, str) else broker, "test")
    try:
        for topic in topics:
            await deliver(link, topic)
    finally:
        await link.disconnect()


@asynccontextmanager
async def server(kind: str | bytes) -> AsyncGenerator[str]:
    """Host and port of a server that is absent, silent, answers, or hangs up."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if kind == "silent":
            await reader.read()
        elif isinstance(kind, bytes):
            await reader.read(1000)
            writer.write(kind)
        writer.close()

    serving = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = serving.sockets[0].getsockname()[1]
    if kind == "absent":
        serving.close()
    yield f"127.0.0.1:{port}"
    serving.close()


@pytest.mark.parametrize(
    ("scheme", "kind", "reason"),
    [
        ("mqtt", "absent", "Connection refused; check that the broker runs and that this is its port"),
        ("mqtt", "silent", r"no response within 0\.1 s; check the address and the network"),
        ("mqtts", "silent", r"(.*timed out|no response within 0\.1 s); check the address and the network"),
        ("mqtt", "hangs up", "the broker closed the connection; if it uses TLS, write mqtts://"),
        ("mqtt", b"\x20\x02\x00\x01", "Unsupported protocol version; slipflow needs a broker of MQTT 5"),
        ("mqtt", b"\x20\x03\x00\x9b\x00", "QoS not supported"),
    ],
)
async def test_a_failed_connection_is_one_line_with_a_remedy(
    monkeypatch: pytest.MonkeyPatch, scheme: str, kind: str | bytes, reason: str
) -> None:
    if kind == "silent":
        monkeypatch.setattr(module, "TIMEOUT", 0.1)
    async with server(kind) as place:
        with pytest.raises(EndpointError, match=rf"^{scheme}://{place}: cannot connect: {reason}$") as caught:
            await use(f"{scheme}://{place}")
    assert caught.type is EndpointError  # nobody refuses


@pytest.mark.parametrize("host", ["no.such.host.invalid", "a..b", "-"])
def test_an_unknown_host_is_one_clear_line(host: str) -> None:
    with pytest.raises(EndpointError, match=rf"^mqtt://{host}:1883: cannot connect: [^\n]+$"):
        asyncio.run(use(f"mqtt://{host}"))


async def test_a_cancelled_attempt_is_disconnected(
    broker: TestBroker, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go_on, clients = threading.Event(), threading.Event(), list[Client]()
    connect = vars(Client)["_client_connect"]

    def connect_slowly(self: Client) -> None:
        clients.append(self)
        begun.set()
        assert go_on.wait(PATIENCE)
        connect(self)

    monkeypatch.setattr(Client, "_client_connect", connect_slowly)
    attempt = asyncio.create_task(use(broker.url))
    await asyncio.to_thread(begun.wait, PATIENCE)
    attempt.cancel()
    await asyncio.sleep(0)
    go_on.set()
    with pytest.raises(asyncio.CancelledError):
        await attempt
    assert inside(clients[0], "_client").socket() is None


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize("turns", [0, 1, 3])
def test_a_lost_connection_is_seen_in_sending(broker: TestBroker, number: signal.Signals, turns: int) -> None:
    async def main() -> None:
        link = await connect(Broker.parse(broker.url), "test")
        await deliver(link, "a")
        broker.stop(number)
        for _ in range(turns):  # the loop may or may not have seen it
            await asyncio.sleep(0)
        with pytest.raises(EndpointError, match=r"connection lost \((?!no response)[^\n]+\)$"):
            await deliver(link, "a")
        assert not link.alive
        await link.disconnect()

    asyncio.run(main(), debug=True)


async def test_a_lost_acknowledgement_times_out(broker: TestBroker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "TIMEOUT", 0.2)
    link = await connect(Broker.parse(broker.url), "test")
    assert broker.process
    broker.process.send_signal(signal.SIGSTOP)
    with pytest.raises(EndpointError, match=r"connection lost \(no response within 0\.2 s\)$"):
        await deliver(link, "a")
    assert not link.alive
    await link.disconnect()


async def test_at_most_10_messages_await_an_answer_which_may_take_its_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    early = list[bytes]()

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1000)
        writer.write(b"\x20\x06\x00\x00\x03\x21\x00\x0a")  # CONNACK with a Receive Maximum of 10
        for _ in range(3):
            publishes = [await reader.readexactly(9) for _ in range(10)]
            with suppress(TimeoutError):
                early.append(await asyncio.wait_for(reader.read(9), 0.3))
            writer.writelines(b"\x40\x02" + each[5:7] for each in publishes)  # PUBACK
        await reader.read()
        writer.close()

    monkeypatch.setattr(module, "TIMEOUT", 0.5)
    async with await asyncio.start_server(answer, "127.0.0.1", 0) as serving:
        link = await connect(Broker("mqtt", "127.0.0.1", serving.sockets[0].getsockname()[1]), "test")
        assert await link.send_all([Message("a", b"x")] * 30) == [""] * 30
        link.abort()
    assert not early


async def test_a_subscription_that_the_broker_refuses_is_an_error() -> None:
    async def refuse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1000)
        writer.write(b"\x20\x03\x00\x00\x00")  # CONNACK
        subscribe = await reader.read(1000)
        writer.write(b"\x90\x04" + subscribe[2:4] + b"\x00\x87")  # SUBACK, not authorized
        await reader.read(1000)
        writer.close()

    async with await asyncio.start_server(refuse, "127.0.0.1", 0) as serving:
        link = await connect(Broker("mqtt", "127.0.0.1", serving.sockets[0].getsockname()[1]), "test")
        with pytest.raises(EndpointError, match=r"refuses to subscribe to a/#: Not authorized; allow it in"):
            await link.listen("a/#")
        await link.disconnect()


def test_a_certificate_for_another_host_is_refused_with_a_hint(
    secure: TestBroker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CA, str(tmp_path / "certificate.pem"))
    url = f"mqtts://localhost:{secure.port}"
    hint = "certificate is not valid for 'localhost'; write the host as in the broker's certificate"
    with pytest.raises(EndpointError, match=rf"{hint}$"):
        asyncio.run(connect(Broker.parse(url), "test"))


def test_mixing_up_tls_and_plain_ports_fails_fast_with_a_hint(secure: TestBroker, tmp_path: Path) -> None:
    (tmp_path / "plain").mkdir()
    with TestBroker(tmp_path / "plain") as plain:
        for url, hint in (
            (secure.url, "if it uses TLS, write mqtts://"),
            (plain.url.replace("mqtt:", "mqtts:"), "if it uses no TLS, write mqtt:// and its port"),
        ):
            with pytest.raises(EndpointError, match=rf"cannot connect: (?!no response).*; {hint}$"):
                asyncio.run(use(url))


async def test_messages_sent_together_arrive_in_order_and_each_refusal_is_reported(
    guarded: TestBroker,
) -> None:
    link = await connect(Broker.parse(guarded.url), "test")
    topics = [f"mine/{number}" for number in range(40)]
    topics[7] = "yours/7"
    refusals = await link.send_all([Message(topic, b"x", retain=False) for topic in topics])
    await link.listen("mine/#")
    for number in range(3):
        await deliver(link, f"mine/{number}", b"y")
    assert [(await link.receive())[0] for _ in range(3)] == topics[:3]
    await link.disconnect()
    assert refusals[7] == "refuses to publish yours/7: Not authorized; allow it in the broker's access list"
    assert [number for number, refusal in enumerate(refusals) if refusal] == [7]


async def test_a_message_larger_than_the_limit_is_not_delivered(broker: TestBroker) -> None:
    link = await connect(Broker.parse(broker.url), "test")
    await link.listen("a/#")
    await deliver(link, "a/large", b"x" * (module.PACKET_MAX + 1))
    await deliver(link, "a/small")
    assert (await link.receive())[0] == "a/small"
    await link.disconnect()
