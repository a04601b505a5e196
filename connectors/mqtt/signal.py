"""Publishing the probability of slip as it goes, over MQTT 5: for eyes, not for decisions."""

from collections import deque
from dataclasses import dataclass

from connectors.events import encode, finger_name, topic
from connectors.mqtt.broker import Broker
from connectors.mqtt.publisher import Message, Publisher
from connectors.mqtt.replay_name import name_in, replay_name
from operators.batch import Scores, s
from operators.errors import ParameterError
from operators.ports import Run, Sink


@dataclass(eq=False)
class MqttSignal(Sink[Scores]):
    """Publishes the newest probability of each fingertip at `rate`.

    As ``{"time_ns": .., "p": ..}`` on ``slip/v1/<site>/<rig>/<finger>/signal``, with QoS 0, not retained.
    While the broker is away the oldest batches are dropped. It has a queue and a connection of its own, so
    that it never holds up the events of `Mqtt`. As there, a replay publishes as another
    rig.

    Raises:
        ParameterError: on a URL, a site, a rig or a rate that cannot be used.
    """

    lossless = False
    capacity = 64  # batches

    url: str  # see `connectors.mqtt.broker.Broker`
    site: str = "lab"
    rig: str = "rig"
    rate: float = 20.0  # Hz, in event time

    def __post_init__(self) -> None:
        self._broker = Broker.parse(self.url, "MqttSignal")
        self._place = self._signals(self.rig)
        if not self.rate > 0:
            raise ParameterError("MqttSignal", "rate", self.rate, "more than 0 Hz")

    @property
    def place(self) -> str:
        """Broker and topic."""
        return self._place

    @property
    def replay_place(self) -> str:
        """Broker and topic in a replay."""
        return self._signals(replay_name(self.rig))

    async def open(self, run: Run) -> None:
        """Connect.

        Raises:
            EndpointError: if the broker is unreachable or refuses us.
            ParameterError: if the rig is live and called as a replay.
        """
        self._due: dict[int, int] = {}  # ns, by finger
        name = name_in(run, "MqttSignal", self.rig)
        place = topic("MqttSignal", self.site, name)
        self._publisher = Publisher(self._broker, place, f"slipflow/{self.site}/{name}/signal")
        await self._publisher.send(deque())

    async def write(self, batch: Scores) -> None:
        """Publish the newest row, if it is time.

        Raises:
            EndpointError: if the broker is lost.
        """
        if not len(batch):
            return
        time = batch.time.item(-1)
        if time < self._due.get(batch.finger, time):
            return
        payload = encode({"time_ns": time, "p": batch.probability.item(-1)})
        message = Message(f"{finger_name(batch.finger)}/signal", payload, qos=0, retain=False)
        await self._publisher.send(deque([message]))
        self._due[batch.finger] = time + round(s / self.rate)

    async def close(self) -> None:
        """Leave."""
        await self._publisher.close()

    def _signals(self, name: str) -> str:
        return f"{self._broker}/{topic('MqttSignal', self.site, name)}/+/signal"
