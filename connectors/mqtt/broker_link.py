"""One connection to an MQTT 5 broker, based on aiomqtt."""

import asyncio
import logging
import re
import socket
import ssl
from collections import deque
from collections.abc import Awaitable, Sequence
from contextlib import suppress
from typing import TypeVar

import aiomqtt
from aiomqtt.exceptions import MqttConnectError
from aiomqtt.types import PahoSocket
from paho.mqtt.client import Client as Paho
from paho.mqtt.client import DisconnectFlags, MQTTMessage
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from connectors.mqtt.broker import CA, CERTIFICATE, PASSWORD, USER, Broker, Message
from operators.errors import EndpointError

T = TypeVar("T")

TIMEOUT = 3.0  # s, for each response of the broker
KEEPALIVE = 5  # s
WILL_DELAY = 2  # s; the will is not published if the client reconnects within this time
SESSION_EXPIRY = 10  # s; the broker publishes the will after this time at the latest
PACKET_MAX = 128 * 1024  # bytes
NOT_AUTHORIZED = 0x87  # MQTT 5.0, section 2.4
INCOMING_MAX = 1000  # unread messages; beyond it, the oldest are dropped

_CLOSED = "the broker closed the connection"
_UNREACHABLE = "check the address and the network"
_EXTENSION = "Python 3.13 needs this extension: create the certificates again"
_HINTS = {  # by text of the error; the first that fits
    "key usage": _EXTENSION,
    "Key Identifier": _EXTENSION,
    "mismatch, certificate is not valid for": "write the host as in the broker's certificate",
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


class Link(aiomqtt.Client):
    """A connection for one use: after it is lost, create another.

    In addition to aiomqtt, it reports messages that the broker refuses, detects a lost connection while it
    waits for a response, and leaves no callback on a closed socket or event loop.
    """

    def __init__(
        self,
        broker: Broker,
        identifier: str,
        will: Message | None = None,
        changed: asyncio.Event | None = None,
    ) -> None:
        """Prepare to connect as client `identifier`, whose session the broker resumes.

        The link sets `changed` when a message arrives or the connection is lost.

        Raises:
            InputError: if the file with the password or the certificate authorities cannot be read.
        """
        session = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        session.SessionExpiryInterval = SESSION_EXPIRY
        session.MaximumPacketSize = PACKET_MAX
        delay = Properties(PacketTypes.WILLMESSAGE)  # type: ignore[no-untyped-call]
        delay.WillDelayInterval = WILL_DELAY
        user, password = broker.login()
        super().__init__(
            broker.host,
            broker.port,
            identifier=identifier,
            username=user,
            password=password,
            protocol=aiomqtt.ProtocolVersion.V5,
            will=aiomqtt.Will(will.topic, will.payload, 1, retain=True, properties=delay) if will else None,
            clean_start=False,  # a clean start would trigger the will of the previous connection
            properties=session,
            tls_context=_tls(broker) if broker.scheme == "mqtts" else None,
            timeout=TIMEOUT,
            keepalive=KEEPALIVE,
            socket_options=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
            logger=_paho_log,
        )
        self._client.connect_timeout = TIMEOUT
        self._url = str(broker)
        self._answers: dict[int, asyncio.Future[ReasonCode]] = {}  # PUBACKs, by packet identifier
        self._deadline = 0.0  # loop time (s), limit for connecting
        self._changed = changed or asyncio.Event()
        self._received = deque[tuple[str, bytes]](maxlen=INCOMING_MAX)  # topic and payload
        self.dropped = 0  # messages that were not read in time

    @property
    def alive(self) -> bool:
        """False after the connection was lost."""
        return not self._disconnected.done()

    async def connect(self) -> None:
        """Connect.

        Raises:
            EndpointError: if the broker is unreachable, does not respond or refuses the client.
        """
        self._deadline = asyncio.get_running_loop().time() + TIMEOUT
        entering = asyncio.ensure_future(self.__aenter__())
        try:
            await asyncio.shield(entering)
        except asyncio.CancelledError:
            with suppress(aiomqtt.MqttError, ValueError):
                await entering  # its thread cannot be stopped and may still run callbacks
            self.abort()
            raise
        except (aiomqtt.MqttError, ValueError) as error:
            self.abort()
            raise EndpointError(self._url, f"cannot connect: {_reason(error)}{self._hint(error)}") from None
        self._disconnected.add_done_callback(lambda _: self._changed.set())

    def peer_certificate(self) -> dict[str, object]:
        """Return the certificate of a broker that uses TLS, as `ssl.SSLSocket.getpeercert` does."""
        sock = self._client.socket()
        return dict((isinstance(sock, ssl.SSLSocket) and sock.getpeercert()) or {})

    def post(self, message: Message) -> None:
        """Publish a message without waiting for its acknowledgement, which may never come."""
        if not (answer := self._publish(message)).cancel():
            answer.exception()  # mark as retrieved, else asyncio logs it

    async def send_all(self, messages: Sequence[Message]) -> list[str]:
        """Publish messages with QoS 1 in order, then wait for all acknowledgements.

        Returns:
            The reason for the refusal of each message; empty if the broker accepted it.

        Raises:
            EndpointError: if the connection is lost; the broker may have received any of the messages.
        """
        answers = [self._publish(message) for message in messages]
        try:
            await self._wait_for(asyncio.gather(*answers), None)
        except aiomqtt.MqttError as error:
            self.abort()
            raise EndpointError(self._url, f"connection lost ({_reason(error)})") from None
        finally:
            for answer in answers:
                answer.cancel()
        refused = zip(messages, (answer.result() for answer in answers), strict=True)
        return [
            f"refuses to publish {message.topic}: {_refusal(code)}" if code.is_failure else ""
            for message, code in refused
        ]

    async def listen(self, *topics: str) -> None:
        """Subscribe to topic filters with QoS 1; `receive` returns their messages.

        Raises:
            EndpointError: if the connection is lost, or the broker refuses a filter.
        """
        try:
            answers = await self.subscribe([(topic, SubscribeOptions(qos=1)) for topic in topics])
        except aiomqtt.MqttError as error:
            raise EndpointError(self._url, f"connection lost ({_reason(error)})") from None
        for topic, answer in zip(topics, answers, strict=True):
            if isinstance(answer, ReasonCode) and answer.is_failure:
                raise EndpointError(self._url, f"refuses to subscribe to {topic}: {_refusal(answer)}")

    async def receive(self) -> tuple[str, bytes]:
        """Return topic and payload of the next message; cancellation loses no message.

        Raises:
            EndpointError: if the connection is lost and all messages received before were returned.
        """
        while (message := self.next_received()) is None:
            self._changed.clear()
            await self._changed.wait()
        return message

    def next_received(self) -> tuple[str, bytes] | None:
        """Return topic and payload of the next message, None if there is none yet.

        Raises:
            EndpointError: if the connection is lost and all messages received before were returned.
        """
        if self._received:
            return self._received.popleft()
        if not self.alive:
            reason = _reason(self._disconnected.exception())
            raise EndpointError(self._url, f"connection lost ({reason})")
        return None

    async def disconnect(self) -> None:
        """Disconnect, so that the broker discards the will."""
        with suppress(aiomqtt.MqttError):
            await self.__aexit__(None, None, None)
        self.abort()

    def abort(self) -> None:
        """Close the socket without DISCONNECT, so that the broker publishes the will."""
        while isinstance(sock := self._client.socket(), socket.socket):
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
            self._client.loop_read()

    def _hint(self, error: Exception) -> str:
        """Return the likely remedy for a failed connection, empty if unknown."""
        text = str(error)
        if isinstance(error, MqttConnectError):
            return f"; check {USER} and {PASSWORD}"
        if hint := next((hint for part, hint in _HINTS.items() if part in text), ""):
            return f"; {hint}"
        tls = self._url.startswith("mqtts:")
        if tls and (text == _CLOSED or "alert" in text):  # after the handshake: the broker has TLS
            return f"; if it asks for client certificates, set {CERTIFICATE} to one that its CA signed"
        if text == _CLOSED or "SSL" in text or "reset by peer" in text:
            return f"; if it uses {'no TLS, write mqtt:// and its port' if tls else 'TLS, write mqtts://'}"
        return ""

    async def _wait_for(self, fut: Awaitable[T], timeout: float | None) -> T:  # noqa: ASYNC109 - signature of the base class
        try:
            limit = self.timeout if timeout is None else timeout
            if fut is self._connected:  # use the time left for connecting
                limit = max(0.0, self._deadline - asyncio.get_running_loop().time())
            async with asyncio.timeout(limit):
                return await fut  # not asyncio.wait_for: before Python 3.12 that may lose a cancellation
        except TimeoutError:
            raise aiomqtt.MqttError("timed out") from None

    def _publish(self, message: Message) -> "asyncio.Future[ReasonCode]":
        answer = asyncio.get_running_loop().create_future()
        properties = None
        if message.content_type:
            properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
            properties.ContentType = message.content_type
        info = self._client.publish(message.topic, message.payload, 1, message.retain, properties)
        if info.rc != MQTTErrorCode.MQTT_ERR_SUCCESS or not self.alive:
            answer.set_exception(aiomqtt.MqttCodeError(info.rc))
        else:
            self._answers[info.mid] = answer
        return answer

    def _on_message(self, client: Paho, userdata: object, message: MQTTMessage) -> None:  # noqa: ARG002
        self.dropped += len(self._received) == self._received.maxlen
        self._received.append((message.topic, bytes(message.payload)))
        self._changed.set()

    def _on_publish(
        self, client: Paho, userdata: object, mid: int, reason_code: ReasonCode, properties: Properties
    ) -> None:
        super()._on_publish(client, userdata, mid, reason_code, properties)
        answer = self._answers.pop(mid, None)
        if answer and not answer.done():
            answer.set_result(reason_code)

    def _on_disconnect(
        self,
        client: Paho,
        userdata: object,
        flags: DisconnectFlags,
        reason_code: ReasonCode,
        properties: Properties | None = None,
    ) -> None:
        super()._on_disconnect(client, userdata, flags, reason_code, properties)
        if not self._connected.done():
            self._connected.set_exception(aiomqtt.MqttError(_CLOSED))
        for future in (self._connected, self._disconnected):
            if future.done() and not future.cancelled():
                future.exception()  # mark as retrieved, else asyncio logs it
        for answer in self._answers.values():  # no PUBACK will arrive
            if not answer.done():
                answer.set_exception(aiomqtt.MqttCodeError(reason_code))
        self._answers.clear()

    def _on_socket_register_write(self, client: Paho, userdata: object, sock: PahoSocket) -> None:  # noqa: ARG002
        def register() -> None:
            if sock.fileno() >= 0:  # it may be closed by now, and its descriptor reused
                self._loop.add_writer(sock, client.loop_write)

        self._loop.call_soon_threadsafe(register)


class _Socket(ssl.SSLSocket):
    def do_handshake(self, block: bool = False) -> None:  # noqa: FBT001, FBT002 - signature of the base class
        self.settimeout(TIMEOUT)
        try:
            super().do_handshake(block)
        except BaseException:
            self.close()  # paho leaves it open
            raise


def _tls(broker: Broker) -> ssl.SSLContext:
    context = broker.tls()
    context.sslsocket_class = _Socket
    return context


def _reason(error: BaseException | None) -> str:
    """Return the reason given by the broker or the system."""
    text = str(error.rc if isinstance(error, aiomqtt.MqttCodeError) else error)
    if error is None or text in ("Unspecified error", str(MQTTErrorCode.MQTT_ERR_NO_CONN)):
        return "closed unexpectedly"
    if text == "timed out":
        return f"no response within {TIMEOUT:g} s"
    return re.sub(r"^\[(Errno -?\d+|SSL[^]]*)\] |\.? \(_ssl\.c:\d+\)$", "", text)


def _refusal(code: ReasonCode) -> str:
    return f"{code}; allow it in the broker's access list" if code.value == NOT_AUTHORIZED else str(code)


async def connect(
    broker: Broker, identifier: str, will: Message | None = None, changed: asyncio.Event | None = None
) -> Link:
    """Connect once; `will` is the message that the broker retains if the client disappears.

    The link sets `changed` when a message arrives or the connection is lost.

    Raises:
        EndpointError: if the broker is unreachable, does not respond or refuses the client.
        InputError: if the file with the password or the certificate authorities cannot be read.
    """
    link = Link(broker, identifier, will, changed)
    await link.connect()
    return link
