"""One connection to an MQTT 5 broker, based on aiomqtt, and findings about the broker before a run."""

import asyncio
import logging
import os
import re
import socket
import ssl
from collections import deque
from collections.abc import AsyncGenerator, Sequence
from contextlib import suppress
from secrets import token_hex
from typing import Any, Final

import aiomqtt
from aiomqtt.exceptions import MqttConnectError
from aiomqtt.types import PahoSocket
from paho.mqtt.client import Client as Paho
from paho.mqtt.client import MQTTMessage
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from connectors.mqtt.broker import CA, CERTIFICATE, PASSWORD, PASSWORD_FILE, USER, Broker, Message
from connectors.web.access import is_loopback
from operators.batch import ms
from operators.errors import EndpointError
from operators.ports import Clock, Finding

TIMEOUT = 3.0  # s, for each response of the broker
KEEPALIVE = 5  # s
WILL_DELAY = 2  # s; the will is not published if the client reconnects within this time
SESSION_EXPIRY = 10  # s; the broker publishes the will after this time at the latest
PACKET_MAX = 128 * 1024  # bytes
NOT_AUTHORIZED = 0x87  # MQTT 5.0, section 2.4
UNANSWERED_MAX = 10  # messages; the smallest Receive Maximum that brokers have by default
INCOMING_MAX = 1000  # unread messages; beyond it, the oldest are dropped

_REFUSAL: Final = 0.2  # s, from the end of a connection to the reason of its refusal
_CLOSED = "the broker closed the connection"
_UNREACHABLE = "check the address and the network"
_EXTENSION = "Python 3.13 needs this extension: create the certificates again"
_HINTS = {  # by text of the error; the first that fits
    "key usage": _EXTENSION,
    "Key Identifier": _EXTENSION,
    "mismatch, certificate is not valid for": "write the host as in the broker's certificate",
    "certificate has expired": "renew the broker's certificate, or set the clock of this machine",
    "certificate is not yet valid": "set the clock of this machine",
    "Unsupported protocol version": "slipflow needs a broker of MQTT 5",
    "CERTIFICATE_VERIFY_FAILED": f"set {CA} to the file of the CA that signed its certificate",
    "Connection refused": "check that the broker runs and that this is its port",
    "Name or service not known": "check the host name",
    "name resolution": "check the host name and the network",
    "timed out": _UNREACHABLE,
    "No route to host": _UNREACHABLE,
    "Network is unreachable": _UNREACHABLE,
}
_paho_log = logging.getLogger("slipflow.paho")  # duplicates the errors raised here
_paho_log.setLevel(logging.CRITICAL)


class Link:
    """A connection for one use: after it is lost, all methods raise `EndpointError`; create another.

    aiomqtt connects, subscribes, and runs the client of paho-mqtt in the event loop. But it ignores the
    reason for which a broker refuses a message (`on_publish`) and the end of a connection that the broker
    has not accepted yet (`on_disconnect`), has no limit of the time to connect, drops the newest messages
    instead of the oldest (`on_message`), and may watch a closed socket (`on_socket_register_write`). So the
    link sets these public attributes of the client of paho-mqtt.
    """

    def __init__(
        self,
        broker: Broker,
        identifier: str,
        will: Message | None = None,
        changed: asyncio.Event | None = None,
    ) -> None:
        """Prepare to connect as client `identifier`, whose session the broker resumes.

        The broker retains `will` if the client disappears. The link sets `changed` when a message arrives or
        the connection is lost. An unreadable file of a password or certificates raises `InputError`.
        """
        session = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        session.SessionExpiryInterval = SESSION_EXPIRY
        session.MaximumPacketSize = PACKET_MAX
        delay = Properties(PacketTypes.WILLMESSAGE)  # type: ignore[no-untyped-call]
        delay.WillDelayInterval = WILL_DELAY
        user, password = broker.login()
        tls = broker.tls() if broker.scheme == "mqtts" else None
        if tls:
            tls.sslsocket_class = _Socket
        self._client = aiomqtt.Client(
            broker.host,
            broker.port,
            identifier=identifier,
            username=user,
            password=password,
            protocol=aiomqtt.ProtocolVersion.V5,
            will=aiomqtt.Will(will.topic, will.payload, 1, retain=True, properties=delay) if will else None,
            clean_start=False,  # a clean start would trigger the will of the previous connection
            properties=session,
            tls_context=tls,
            timeout=TIMEOUT,
            keepalive=KEEPALIVE,
            max_inflight_messages=UNANSWERED_MAX,
            socket_options=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
            logger=_paho_log,
        )
        self._paho = paho = self._client._client  # noqa: SLF001 - see above
        paho.connect_timeout = TIMEOUT
        paho.on_publish, paho.on_message = self._on_publish, self._on_message
        paho.on_disconnect, paho.on_socket_register_write = self._on_disconnect, self._watch_socket
        self._url = str(broker)
        self._loop = asyncio.get_running_loop()
        self._answers: dict[int, tuple[str, asyncio.Future[str | None]]] = {}  # topic and PUBACK, by its id
        self._lost: asyncio.Future[str] = self._loop.create_future()  # reason
        self._changed = changed or asyncio.Event()
        self._received = deque[tuple[str, bytes]](maxlen=INCOMING_MAX)  # topic and payload
        self.dropped = 0  # messages that were not read in time; a reader that reports them sets it to 0

    @property
    def alive(self) -> bool:
        """False after the connection was lost."""
        return not self._lost.done()

    async def connect(self) -> None:
        """Connect.

        Raises:
            EndpointError: if the broker is unreachable, does not respond or refuses the client.
        """
        entering = asyncio.ensure_future(self._client.__aenter__())
        entering.add_done_callback(lambda task: task.cancelled() or task.exception())  # if nobody awaits it
        try:
            waits: set[asyncio.Future[Any]] = {entering, self._lost}
            await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
            await asyncio.wait([entering], timeout=_REFUSAL)  # a broker that refuses also closes
            if not entering.done():
                entering.cancel()
                raise aiomqtt.MqttError(_CLOSED)  # noqa: TRY301 - reported as those of aiomqtt
            await entering
        except asyncio.CancelledError:
            await asyncio.wait([entering])  # its thread cannot be stopped and may still run callbacks
            self.abort()
            raise
        except (aiomqtt.MqttError, ValueError) as error:
            self.abort()
            raise EndpointError(self._url, f"cannot connect: {_reason(error)}{self._hint(error)}") from None

    async def send_all(self, messages: Sequence[Message]) -> list[str]:
        """Publish messages with QoS 1 in order, then wait for all acknowledgements.

        Returns the reason for the refusal of each message; empty if the broker accepted it. If the connection
        is lost, the broker may have received any of them.
        """
        answers = [self.publish(message) for message in messages]
        for first in range(0, len(answers), UNANSWERED_MAX):
            if (await asyncio.wait(answers[first : first + UNANSWERED_MAX], timeout=TIMEOUT))[1]:
                self._lose(_reason(TimeoutError()))
        refusals = [reason for each in answers if (reason := each.result()) is not None]
        if len(refusals) < len(messages):
            self.abort()
            raise self._loss()
        return refusals

    async def listen(self, *topics: str) -> None:
        """Subscribe to topic filters with QoS 1; `receive` returns their messages.

        Raises:
            EndpointError: if the broker refuses a filter.
        """
        filters = [(topic, SubscribeOptions(qos=1)) for topic in topics]
        try:
            answers = await self._client.subscribe(filters)
        except aiomqtt.MqttError as error:
            raise EndpointError(self._url, f"connection lost ({_reason(error)})") from None
        for topic, answer in zip(topics, answers, strict=True):
            if isinstance(answer, ReasonCode) and answer.is_failure:
                raise EndpointError(self._url, f"refuses to subscribe to {topic}: {_refusal(answer)}")

    async def receive(self) -> tuple[str, bytes]:
        """Return topic and payload of the next message, also after a loss; cancellation loses none."""
        while (message := self.next_received()) is None:
            self._changed.clear()
            await self._changed.wait()
        return message

    def next_received(self) -> tuple[str, bytes] | None:
        """Return topic and payload of the next message, None if there is none yet."""
        if self._received:
            return self._received.popleft()
        if not self.alive:
            raise self._loss()
        return None

    async def disconnect(self) -> None:
        """Disconnect, so that the broker discards the will."""
        if self.alive:
            self._paho.disconnect()
            await asyncio.wait([self._lost], timeout=TIMEOUT)
        self.abort()

    def abort(self) -> None:
        """Close the socket without DISCONNECT, so that the broker publishes the will."""
        while isinstance(sock := self._paho.socket(), socket.socket):
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
            self._paho.loop_read()

    def _hint(self, error: Exception) -> str:
        """Return the likely remedy for a failed connection, empty if unknown."""
        text = str(error)
        if isinstance(error, MqttConnectError) and text.endswith(("Not authorized", "user name or password")):
            path, unset = os.environ.get(PASSWORD_FILE), "" if os.environ.get(USER) else ", which is not set,"
            return f"; check {USER}{unset} and {f'the password in {path}' if path else PASSWORD}"
        if hint := next((hint for part, hint in _HINTS.items() if part in text), ""):
            return f"; {hint}"
        tls = self._url.startswith("mqtts:")
        if tls and (text == _CLOSED or "alert" in text):  # after the handshake: the broker has TLS
            if path := os.environ.get(CERTIFICATE):
                return f"; check that {path} has not expired and that the broker's CA signed it"
            return f"; if it asks for client certificates, set {CERTIFICATE} to one that its CA signed"
        if text == _CLOSED or "SSL" in text or "reset by peer" in text:
            return f"; if it uses {'no TLS, write mqtt:// and its port' if tls else 'TLS, write mqtts://'}"
        return ""

    def _loss(self) -> EndpointError:
        return EndpointError(self._url, f"connection lost ({self._lost.result()})")

    def _lose(self, reason: str) -> None:
        """Note that the connection is lost; no PUBACK will arrive."""
        if self.alive:
            self._lost.set_result(reason)
        while self._answers:
            self._answers.popitem()[1][1].set_result(None)
        self._changed.set()

    def publish(self, message: Message) -> "asyncio.Future[str | None]":
        """Publish a message; return the future reason for its refusal, as `send_all`; None after a loss."""
        answer: asyncio.Future[str | None] = self._loop.create_future()
        properties = None
        if message.content_type:
            properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
            properties.ContentType = message.content_type
        info = self._paho.publish(message.topic, message.payload, 1, message.retain, properties)
        self._answers[info.mid] = message.topic, answer
        if info.rc != MQTTErrorCode.MQTT_ERR_SUCCESS or not self.alive:
            self._lose(_reason(aiomqtt.MqttCodeError(info.rc)))
        return answer

    def _on_message(self, client: Paho, userdata: object, message: MQTTMessage) -> None:
        self.dropped += len(self._received) == self._received.maxlen
        self._received.append((message.topic, bytes(message.payload)))
        self._changed.set()

    def _on_publish(self, client: Paho, userdata: object, mid: int, code: ReasonCode, _: Properties) -> None:
        topic, answer = self._answers.pop(mid, ("", None))
        if answer:
            answer.set_result(f"refuses to publish {topic}: {_refusal(code)}" if code.is_failure else "")

    def _on_disconnect(self, client: Paho, data: object, flags: object, code: ReasonCode, _: object) -> None:
        self._lose(_reason(aiomqtt.MqttCodeError(code)))

    def _watch_socket(self, client: Paho, userdata: object, sock: PahoSocket) -> None:
        def register() -> None:
            if sock.fileno() >= 0:  # it may be closed by now, and its descriptor reused
                self._loop.add_writer(sock, client.loop_write)

        self._loop.call_soon_threadsafe(register)


class _Socket(ssl.SSLSocket):
    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except BaseException:
            self.close()  # paho leaves it open
            raise


def _reason(error: BaseException | None) -> str:
    """Return the reason given by the broker or the system."""
    text = str(error.rc if isinstance(error, aiomqtt.MqttCodeError) else error)
    if error is None or text in ("Unspecified error", str(MQTTErrorCode.MQTT_ERR_NO_CONN)):
        return "closed unexpectedly"
    if text in ("timed out", "Operation timed out", ""):
        return f"no response within {TIMEOUT:g} s"
    return re.sub(r"^\[(Errno -?\d+|SSL[^]]*)\] |\.? \(_ssl\.c:\d+\)$", "", text)


def _refusal(code: ReasonCode) -> str:
    return f"{code}; allow it in the broker's access list" if code.value == NOT_AUTHORIZED else str(code)


async def connect(
    broker: Broker, identifier: str, will: Message | None = None, changed: asyncio.Event | None = None
) -> Link:
    """Return a new connection, as `Link` and `Link.connect` make it."""
    link = Link(broker, identifier, will, changed)
    await link.connect()
    return link


async def diagnose_broker(broker: Broker, topic: str, clock: Clock) -> AsyncGenerator[Finding]:
    """Yield findings about a broker, which gets one message on `topic`, not retained.

    Raises:
        EndpointError: if the broker is unreachable or refuses the client or the message.
    """
    link = await connect(broker, f"slipflow-doctor-{token_hex(4)}")
    try:
        yield _login(broker)
        if broker.scheme == "mqtts":
            yield Finding(str(broker), "TLS with a trusted certificate")
        start = clock.now()
        [refusal] = await link.send_all([Message(topic, b"{}", retain=False)])
        if refusal:
            raise EndpointError(str(broker), refusal)
        yield Finding(str(broker), f"accepts {topic} within {(clock.now() - start) / ms:.1f} ms")
    finally:
        await link.disconnect()


def _login(broker: Broker) -> Finding:
    """Return how the client logs in, with a note if its password can be read on the network."""
    user, password = broker.login()
    who = f"user {user}{' with a password' if password else ''}" if user else "any client"
    if broker.scheme == "mqtts" and (own := os.environ.get(CERTIFICATE)):
        return Finding(str(broker), f"admits {who if user else 'this client'} with the certificate {own}")
    if password and broker.scheme == "mqtt" and not is_loopback(broker.host):
        text = f"admits {who}, sent without encryption: set up TLS and write mqtts://"
        return Finding(str(broker), text, "note")
    remedy = f"; set {USER} if it should not" if not user and not is_loopback(broker.host) else ""
    return Finding(str(broker), f"admits {who}{remedy}", "note" if remedy else "good")
