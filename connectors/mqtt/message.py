"""What is published over MQTT."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Message:
    """A topic and what is said there."""

    topic: str
    payload: bytes
    qos: int = 1
    retain: bool = True
