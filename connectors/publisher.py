"""Publishing below one MQTT topic over a connection that is made again whenever it is lost."""

import asyncio
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from connectors.broker import Broker
from operators.errors import EndpointError

if TYPE_CHECKING:
    from connectors.link import Link


@dataclass(frozen=True, slots=True)
class Message:
    """What is to be published."""

    topic: str  # below that of the publisher
    payload: bytes
    qos: int = 1
    retain: bool = True


class Publisher:
    """Publishes messages one at a time, in order.

    After each new connection it first repeats what the broker should retain, for that may have forgotten.
    """

    def __init__(self, broker: Broker, topic: str, identifier: str, will: Message | None = None) -> None:
        """Get ready to publish below `topic`; the broker publishes `will` if we vanish."""
        self._broker, self._topic, self._identifier = broker, topic, identifier
        self._will = (f"{topic}/{will.topic}", will.payload) if will else None
        self._retained: dict[str, Message] = {}  # by topic
        self._link: Link | None = None
        self._turn = asyncio.Lock()

    async def send(self, messages: deque[Message]) -> None:
        """Publish and remove each message, connecting if need be; one that fails stays, and so do the next.

        Raises:
            EndpointError: if the broker is unreachable or refuses.
        """
        async with self._turn:
            if not (self._link and self._link.alive):
                from connectors.link import connect  # noqa: PLC0415 - aiomqtt takes 0.2 s to import

                self._link = await connect(self._broker, self._identifier, self._will)
                await self._publish(self._link, self._retained.values())
            while messages:
                await self._publish(self._link, [messages[0]])
                message = messages.popleft()
                if message.retain:
                    self._retained[message.topic] = message

    async def close(self, *farewell: Message) -> None:
        """Publish a farewell and leave; where the connection is lost, the will has to do."""
        async with self._turn:
            if self._link and self._link.alive:
                with suppress(EndpointError):
                    await self._publish(self._link, farewell)
                await self._link.leave()
            self._link = None

    async def _publish(self, link: "Link", messages: Iterable[Message]) -> None:
        for message in messages:
            topic = f"{self._topic}/{message.topic}"
            await link.send(topic, message.payload, qos=message.qos, retain=message.retain)
