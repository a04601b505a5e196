import asyncio
import json
from collections.abc import Awaitable, Callable
from dataclasses import replace

import numpy as np
import pytest

from connectors import Mqtt, MqttSignal
from connectors.mqtt.broker_link import Link
from operators.batch import Scores, ms
from operators.errors import EndpointError, ParameterError
from operators.ports import Run
from tests.connectors.mqtt.broker_process import TestBroker

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]


def scores(*times: int, finger: int = 0, probability: float = 0.5) -> Scores:
    return Scores(ms * np.array(times, np.int64), np.full(len(times), probability), finger=finger)


def use(sink: MqttSignal, run: Run, body: Callable[[], Awaitable[None]]) -> None:
    async def main() -> None:
        await sink.open(run)
        await body()
        await sink.close()

    asyncio.run(main())


def test_the_newest_probability_of_each_finger_is_published_at_the_rate(broker: TestBroker, run: Run) -> None:
    sink = MqttSignal(broker.url, rate=20)
    listener = broker.listen("slip/v1/lab/rig/+/signal")

    async def body() -> None:
        await sink.write(scores(finger=1))
        for time in range(0, 120, 10):
            await sink.write(scores(time - 1, time))
        await sink.write(scores(120, finger=2, probability=float("nan")))

    use(sink, run, body)
    received = [listener.next() for _ in range(4)]
    assert [(r.topic.split("/")[4], json.loads(r.payload)) for r in received] == [
        ("0", {"time_ns": 0, "p": 0.5}),
        ("0", {"time_ns": 50 * ms, "p": 0.5}),
        ("0", {"time_ns": 100 * ms, "p": 0.5}),
        ("2", {"time_ns": 120 * ms, "p": None}),
    ]


def test_it_comes_back_with_the_broker(broker: TestBroker, run: Run) -> None:
    sink = MqttSignal(broker.url)

    async def body() -> None:
        broker.stop()
        with pytest.raises(EndpointError):
            await sink.write(scores(0))
        broker.start()
        listener = broker.listen("slip/v1/lab/rig/0/signal")
        await sink.write(scores(0))
        assert json.loads(listener.next().payload)["time_ns"] == 0

    use(sink, run, body)


def test_events_and_signal_of_a_rig_have_different_places_and_connections(
    broker: TestBroker, run: Run, links: list[Link]
) -> None:
    events, sink = Mqtt(broker.url), MqttSignal(broker.url)
    assert events.place != sink.place

    async def body() -> None:
        await events.open(run)
        await sink.write(scores(0))
        assert [link.alive for link in links] == [True, True]
        await events.close()

    use(sink, run, body)


def test_a_replay_is_published_as_another_rig_by_another_client(broker: TestBroker, run: Run) -> None:
    listener = broker.listen("slip/#")
    live, again = MqttSignal(broker.url), MqttSignal(broker.url)
    assert again.replay_place == f"mqtt://127.0.0.1:{broker.port}/slip/v1/lab/rig-replay/+/signal"

    async def replay() -> None:
        await again.open(replace(run, recording="stroke-9"))
        await again.write(scores(10))
        await live.write(scores(20))
        await again.close()

    use(live, run, replay)
    topics = [listener.next().topic for _ in range(2)]
    assert topics == ["slip/v1/lab/rig-replay/0/signal", "slip/v1/lab/rig/0/signal"]


def test_no_live_rig_is_called_as_a_replay(run: Run) -> None:
    with pytest.raises(
        ParameterError, match=r"^MqttSignal: rig is 'ur10-replay', must be a name that does not"
    ):
        asyncio.run(MqttSignal("mqtt://localhost", rig="ur10-replay").open(run))


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan")])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(ParameterError, match=r"^MqttSignal: rate is "):
        MqttSignal("mqtt://localhost", rate=rate)
