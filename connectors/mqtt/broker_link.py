"""One connection to an MQTT 5 broker: aiomqtt with its traps closed."""

import asyncio
import logging
import re
import socket
import ssl
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from typing import TypeVar

import aiomqtt
from aiomqtt.exceptions import MqttConnectError
from aiomqtt.types import PahoSocket
from paho.mqtt.client import Client as Paho
from paho.mqtt.client import DisconnectFlags
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from connectors.mqtt.broker import CA, PASSWORD, USER, Broker
from connectors.mqtt.message import Message
from operators.errors import EndpointError

T = TypeVar("T")

TIMEOUT = 3.0  # s, for each answer of the broker
KEEPALIVE = 5  # s
WILL_DELAY = 2  # s; a connection that is back by then was never away
SESSION_EXPIRY = 10  # s; the broker sends the will no later than this
PACKET = 128 * 1024  # bytes; the broker delivers no larger one
NOT_AUTHORIZED = 0x87  # a reason of MQTT 5
INCOMING = 1000  # messages that may wait to be read; then the oldest are dropped

_CLOSED = "the broker closed the connection"
_AWAY = "is this its address, and is the network up?"
_HINTS = {  # by what the system says
    "Connection refused": "is the broker running, and is this its port?",
    "Name or service not known": "is the name right, and does the network know it?",
    "name resolution": "is the name right, and is the network up?",
    "timed out": _AWAY,
    "No route to host": _AWAY,
    "Network is unreachable": _AWAY,
}
_paho_log = logging.getLogger("slipflow.paho")  # it repeats what our errors say
_paho_log.setLevel(logging.CRITICAL)


class Newest(asyncio.Queue[aiomqtt.Message]):
    """A queue that drops its oldest message when it is full, and counts."""

    dropped = 0
    on_news: Callable[[], object] = staticmethod(lambda: None)  # called when there is a message

    def put_nowait(self, item: aiomqtt.Message) -> None:
        """Add a message."""
        if self.full():
            self.get_nowait()
            self.dropped += 1
        super().put_nowait(item)
        self.on_news()


class Link(aiomqtt.Client):
    """A connection for one use: once it is lost, make another.

    Beyond aiomqtt it raises what the broker refuses, notices a lost connection while it waits for an answer,
    and leaves no callback behind on a closed socket or event loop.
    """

    def __init__(self, broker: Broker, identifier: str, will: tuple[str, bytes] | None = None) -> None:
        """Get ready to connect as `identifier`, by which the broker knows us again when we are back.

        Raises:
            InputError: if the file with the password or the trusted authorities cannot be read.
        """
        session = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        session.SessionExpiryInterval = SESSION_EXPIRY
        session.MaximumPacketSize = PACKET
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
            will=aiomqtt.Will(*will, qos=1, retain=True, properties=delay) if will else None,
            clean_start=False,  # a clean start would set off the will of the connection before
            properties=session,
            tls_context=_tls(broker) if broker.scheme == "mqtts" else None,
            timeout=TIMEOUT,
            keepalive=KEEPALIVE,
            socket_options=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
            queue_type=Newest,
            max_queued_incoming_messages=INCOMING,
            logger=_paho_log,
        )
        self._client.connect_timeout = TIMEOUT
        self._place = str(broker)
        self._answers: dict[int, asyncio.Future[ReasonCode]] = {}  # to what was published, by number
        self._deadline = 0.0  # of the loop's clock, for connecting
        self._stirred = asyncio.Event()  # a message came, or the connection was lost
        if isinstance(self._queue, Newest):
            self._queue.on_news = self._stirred.set

    @property
    def alive(self) -> bool:
        """False once the connection is lost."""
        return not self._disconnected.done()

    @property
    def dropped(self) -> int:
        """Messages that came in faster than they were read."""
        return self._queue.dropped if isinstance(self._queue, Newest) else 0

    async def connect(self) -> None:
        """Connect.

        Raises:
            EndpointError: if the broker is unreachable, silent or refuses us.
        """
        self._deadline = asyncio.get_running_loop().time() + TIMEOUT
        entering = asyncio.ensure_future(self.__aenter__())
        try:
            await asyncio.shield(entering)
        except asyncio.CancelledError:
            with suppress(aiomqtt.MqttError, ValueError):
                await entering  # in a thread that cannot be stopped, and may call back
            self.drop()
            raise
        except (aiomqtt.MqttError, ValueError) as error:
            self.drop()
            raise EndpointError(self._place, f"cannot connect: {_reason(error)}{self._hint(error)}") from None
        self.on_lost(self._stirred.set)

    def on_lost(self, call: Callable[[], object]) -> None:
        """Have `call` called when the connection is lost."""
        self._disconnected.add_done_callback(lambda _: call())

    async def send(self, topic: str, payload: bytes, *, qos: int = 1, retain: bool = False) -> None:
        """Publish; with `qos` 1 the broker has it once this returns.

        Raises:
            EndpointError: if the connection is lost, or the broker refuses the message.
        """
        [refusal] = await self.send_all([Message(topic, payload, qos, retain)])
        if refusal:
            raise EndpointError(self._place, refusal)

    async def send_all(self, messages: Sequence[Message]) -> list[str]:
        """Publish messages in order, and wait for the answers only then.

        Gives for each why the broker refuses it, empty where it does not.

        Raises:
            EndpointError: if the connection is lost; then nobody knows what the broker has.
        """
        answers = [self._publish(message) for message in messages]
        try:
            await self._wait_for(asyncio.gather(*answers), None)
        except aiomqtt.MqttError as error:
            self.drop()
            raise EndpointError(self._place, f"connection lost ({_reason(error)})") from None
        finally:
            for answer in answers:
                answer.cancel()
        refused = zip(messages, (answer.result() for answer in answers), strict=True)
        return [
            f"refuses to publish {message.topic}: {_refusal(code)}" if code.is_failure else ""
            for message, code in refused
        ]

    async def listen(self, *topics: str) -> None:
        """Subscribe to topic filters, with QoS 1; see `incoming`.

        Raises:
            EndpointError: if the connection is lost, or the broker refuses.
        """
        try:
            answers = await self.subscribe([(topic, SubscribeOptions(qos=1)) for topic in topics])
        except aiomqtt.MqttError as error:
            raise EndpointError(self._place, f"connection lost ({_reason(error)})") from None
        for topic, answer in zip(topics, answers, strict=True):
            if isinstance(answer, ReasonCode) and answer.is_failure:
                raise EndpointError(self._place, f"refuses to subscribe to {topic}: {_refusal(answer)}")

    async def receive(self) -> tuple[str, bytes]:
        """Topic and payload of the next message; being cancelled loses none.

        Raises:
            EndpointError: once the connection is lost, and all that came before was given.
        """
        while self._queue.empty():
            if not self.alive:
                reason = _reason(self._disconnected.exception())
                raise EndpointError(self._place, f"connection lost ({reason})")
            self._stirred.clear()
            await self._stirred.wait()
        message = self._queue.get_nowait()
        return message.topic.value, message.payload

    async def leave(self) -> None:
        """Say farewell and close: the broker forgets the will."""
        with suppress(aiomqtt.MqttError):
            await self.__aexit__(None, None, None)
        self.drop()

    def drop(self) -> None:
        """Close without a word: the broker sends the will."""
        while isinstance(sock := self._client.socket(), socket.socket):
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
            self._client.loop_read()

    def _hint(self, error: Exception) -> str:
        """What to do about a connection that was not made; empty where nobody knows."""
        text = str(error)
        if isinstance(error, MqttConnectError):
            return f"; check {USER} and {PASSWORD}"
        if "CERTIFICATE_VERIFY_FAILED" in text:
            return f"; name the file of the authority that signed it in {CA}"
        if text == _CLOSED or "SSL" in text or "reset by peer" in text:
            tls = self._place.startswith("mqtts:")
            return (
                "; if it speaks no TLS, say mqtt:// and its port"
                if tls
                else "; if it speaks TLS, say mqtts://"
            )
        return next((f"; {hint}" for part, hint in _HINTS.items() if part in text), "")

    async def _wait_for(self, fut: Awaitable[T], timeout: float | None) -> T:  # noqa: ASYNC109 - as the base has it
        try:
            limit = self.timeout if timeout is None else timeout
            if fut is self._connected:  # what connecting has left of it
                limit = max(0.0, self._deadline - asyncio.get_running_loop().time())
            async with asyncio.timeout(limit):
                return await fut  # not asyncio.wait_for: before Python 3.12 that may lose a cancellation
        except TimeoutError:
            raise aiomqtt.MqttError("timed out") from None

    def _publish(self, message: Message) -> "asyncio.Future[ReasonCode]":
        answer = asyncio.get_running_loop().create_future()
        info = self._client.publish(message.topic, message.payload, message.qos, message.retain)
        if info.rc != MQTTErrorCode.MQTT_ERR_SUCCESS or not self.alive:
            answer.set_exception(aiomqtt.MqttCodeError(info.rc))
        elif info.is_published():  # with QoS 0, handed to the system
            answer.set_result(ReasonCode(PacketTypes.PUBACK))
        else:
            self._answers[info.mid] = answer
        return answer

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
                future.exception()  # nobody may ever ask: asyncio need not complain
        for answer in self._answers.values():  # none will come
            if not answer.done():
                answer.set_exception(aiomqtt.MqttCodeError(reason_code))
        self._answers.clear()

    def _on_socket_register_write(self, client: Paho, userdata: object, sock: PahoSocket) -> None:  # noqa: ARG002
        def register() -> None:
            if sock.fileno() >= 0:  # by now it may be closed, and its number another socket's
                self._loop.add_writer(sock, client.loop_write)

        self._loop.call_soon_threadsafe(register)


class _Socket(ssl.SSLSocket):
    def do_handshake(self, block: bool = False) -> None:  # noqa: FBT001, FBT002 - as the base has it
        self.settimeout(TIMEOUT)
        try:
            super().do_handshake(block)
        except BaseException:
            self.close()  # paho forgets it
            raise


def _tls(broker: Broker) -> ssl.SSLContext:
    context = broker.tls()
    context.sslsocket_class = _Socket
    return context


def _reason(error: BaseException | None) -> str:
    """What happened, in the broker's words, or the system's."""
    text = str(error.rc if isinstance(error, aiomqtt.MqttCodeError) else error)
    if error is None or text in ("Unspecified error", str(MQTTErrorCode.MQTT_ERR_NO_CONN)):
        return "closed unexpectedly"
    if text == "timed out":
        return f"no answer within {TIMEOUT:g} s"
    return re.sub(r"^\[(Errno -?\d+|SSL[^]]*)\] | \(_ssl\.c:\d+\)$", "", text)


def _refusal(code: ReasonCode) -> str:
    return f"{code}; its access list must allow it" if code.value == NOT_AUTHORIZED else str(code)


async def connect(broker: Broker, identifier: str, will: tuple[str, bytes] | None = None) -> Link:
    """Connect once; `will` is the topic and payload that the broker retains there if we vanish.

    Raises:
        EndpointError: if the broker is unreachable, silent or refuses us.
        InputError: if the file with the password or the trusted authorities cannot be read.
    """
    link = Link(broker, identifier, will)
    await link.connect()
    return link
