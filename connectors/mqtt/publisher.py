"""Publishing below one MQTT topic over a connection that is made again whenever it is lost."""

from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

from connectors.mqtt.broker import Broker
from connectors.mqtt.message import Message
from operators.errors import EndpointError

if TYPE_CHECKING:
    from connectors.mqtt.broker_link import Link

__all__ = ["Message", "Publisher"]


class Publisher:
    """Publishes messages one at a time, in order, and keeps none: for what may be lost."""

    def __init__(self, broker: Broker, topic: str, identifier: str) -> None:
        """Get ready to publish below `topic`."""
        self._broker, self._topic, self._identifier = broker, topic, identifier
        self._link: Link | None = None

    async def send(self, messages: deque[Message]) -> None:
        """Publish and remove each message, connecting if need be; one that fails stays, and so do the next.

        Raises:
            EndpointError: if the broker is unreachable or refuses.
        """
        if not (self._link and self._link.alive):
            from connectors.mqtt.broker_link import connect  # noqa: PLC0415 - aiomqtt takes 0.2 s to import

            self._link = await connect(self._broker, self._identifier)
        while messages:
            message = replace(messages[0], topic=f"{self._topic}/{messages[0].topic}")
            [refusal] = await self._link.send_all([message])
            if refusal:
                raise EndpointError(str(self._broker), refusal)
            messages.popleft()

    async def close(self) -> None:
        """Leave."""
        if self._link:
            await self._link.leave()
        self._link = None
