"""A live rig and replays of it on one real broker, as subscribers of both see them."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from connectors import Mqtt
from connectors.mqtt.rig_names import outbox_path
from flows.graph import Flow
from flows.graph.testing import TestSource
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from flows.run.replay_runner import ReplayRunner, first_time, replayed
from operators import Operator, Slips, Touch, ms, s
from operators.ports import Clock, Run, Source
from tests.connectors.mqtt.broker_process import Received, TestBroker
from tests.flows.run.live import Memory

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]

RIG, REPLAY = "slip/v1/lab/rig", "slip/v1/lab/rig-replay"
RECORDED = 1_700_000_000 * s  # ns


@dataclass
class Turns(Operator[Touch, Slips]):
    """Each row is an onset or an end, as its first count is odd or even."""

    def process(self, batch: Touch) -> Slips:
        state = (batch.counts[:, 0] % 2).astype(np.int8)  # (n,)
        return Slips(batch.time, state, batch.time, np.full(len(batch), 0.9), finger=batch.finger)


def pressed(time: int, rows: int) -> Touch:
    """Rows 10 ms apart from `time` (ns) on, whose counts go up."""
    times = time + 10 * ms * np.arange(rows)  # (n,)
    counts = np.repeat(np.arange(1, rows + 1, dtype=np.int16)[:, None], 6, axis=1)  # (n, 6)
    return Touch(times, counts, counts, np.ones(counts.shape, np.bool_), finger=0)


def given(rows: int = 0) -> TestSource[Touch]:
    return TestSource(Touch, [pressed(0, rows)], fingers=(0,))


def recorded() -> Memory:
    """A recording of one fingertip."""
    return Memory(pressed(RECORDED, 7))


def declared(url: str, source: Source[Touch], rig: str = "rig", outbox: Path | None = None) -> Flow:
    flow = Flow("turns")
    touch = flow.source(source)
    (touch | Turns()).to(Mqtt(url, rig=rig, outbox=outbox))
    return flow


async def at_full_speed(flow: Flow) -> Run:
    return await ReplayRunner(flow, recorded(), "again").execute()


async def at_a_pace(flow: Flow) -> Run:
    recording = recorded()
    clock = LoopClock(first_time(recording), 10)
    return await LiveRunner(replayed(flow, recording), "again", clock=clock).execute()


Way = Callable[[Flow], Coroutine[Any, Any, Run]]
BOTH = pytest.mark.parametrize("replay", [at_full_speed, at_a_pace])


class Fed(TestSource[Touch]):
    """Fingertip that yields a row on request."""

    def __init__(self) -> None:
        super().__init__(Touch, fingers=(0,))
        self._told = asyncio.Queue[bool]()

    def press(self, *, more: bool = True) -> None:
        self._told.put_nowait(more)

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        while await self._told.get():
            yield pressed(clock.now(), 1)


def sessions(received: list[Received], rig: str) -> list[Any]:
    """The sessions of the events among them."""
    topic = f"{rig}/0/event"
    return [json.loads(each.payload)["data"]["session"] for each in received if each.topic == topic]


@BOTH
def test_consumers_of_a_live_rig_receive_nothing_from_a_replay(broker: TestBroker, replay: Way) -> None:
    rig, both = broker.listen(f"{RIG}/#"), broker.listen("slip/#")

    async def main() -> None:
        fingertip = Fed()
        live = asyncio.create_task(LiveRunner(declared(broker.url, fingertip), "live").execute())
        fingertip.press()
        await asyncio.to_thread(rig.next, f"{RIG}/0/state")
        done = await replay(declared(broker.url, given()))
        assert [sink.rows for sink in done.sinks.values()] == [7]
        fingertip.press()
        await asyncio.to_thread(rig.next, f"{RIG}/0/state")
        fingertip.press(more=False)
        await live

    asyncio.run(main())
    assert {each.topic.removeprefix(RIG)[0] for each in rig.rest()} <= {"/"}
    heard = both.rest()
    assert sessions(heard, RIG) == ["live", "live"]
    assert sessions(heard, REPLAY) == ["again"] * 7
    ours = [json.loads(each.payload) for each in heard if each.topic.startswith(f"{RIG}/")]
    assert not [document for document in ours if "again" in json.dumps(document)]
    assert [each["state"] for each in ours if "state" in each and "version" in each] == ["online", "offline"]
    numbers = [document["data"]["seq"] for document in ours if "specversion" in document]
    assert numbers == [1, 2]
    times = [document["data"]["sample_time_ns"] for document in ours if "specversion" in document]
    assert min(times) > RECORDED + s


@BOTH
def test_a_replay_keeps_retained_messages_and_files_of_the_rig(
    broker: TestBroker, replay: Way, tmp_path: Path
) -> None:
    async def live() -> None:
        await LiveRunner(declared(broker.url, given(3)), "live").execute()

    asyncio.run(live())
    before = broker.listen(f"{RIG}/#").rest()
    outbox = {path: path.read_bytes() for path in outbox_path("lab", "rig").iterdir()}
    asyncio.run(replay(declared(broker.url, given())))
    assert broker.listen(f"{RIG}/#").rest() == before
    assert {path: path.read_bytes() for path in outbox_path("lab", "rig").iterdir()} == outbox
    named = tmp_path / "named.outbox"
    asyncio.run(replay(declared(broker.url, given(), "other", named)))
    assert not named.exists()
    assert (tmp_path / "named-replay.outbox").exists()
