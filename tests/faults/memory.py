"""Bounds of the memory of rig and consumer in a simulation."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from connectors.mqtt import outbox as outbox_module
from storage.journal import Buffer
from tests.faults.simulated_rig import WatchedDataset, WatchedMqtt
from tests.inside import inside

if TYPE_CHECKING:
    from tests.faults.world import World

TASKS_MAX: Final = 24  # of a process
CAPACITY: Final = 16  # batches in the queue of a sink
PART_ROWS: Final = 100  # rows of a table in memory
EVENTS_MAX: Final = 24  # in the memory of the outbox


def excess(world: World) -> Iterator[str]:
    """Yield a line for each process, queue or buffer that has more objects than its bound."""
    for process in (world.rig, world.consumer):
        if process and len(process.tasks) > TASKS_MAX:
            yield f"the {process.name} has {len(process.tasks)} tasks"
    if not world.runner:
        return
    for queue in inside(world.runner, "_queues").values():
        if (waiting := len(inside(queue, "_waiting"))) > CAPACITY:
            yield f"{waiting} batches wait for {queue.name}"
        if isinstance(queue.sink, WatchedDataset) and (writer := inside(queue.sink, "_writer")):
            buffers: list[dict[str, Buffer]] = [
                inside(writer, "_buffers"),
                inside(writer, "_committing") or {},
            ]
            rows = max((each["touch"].rows for each in buffers if "touch" in each), default=0)
            if rows > PART_ROWS:
                yield f"{rows} rows of a table are in memory"
        if isinstance(queue.sink, WatchedMqtt) and hasattr(queue.sink, "_outbox"):
            events = len(inside(queue.sink, "_outbox", "_memory"))
            if events > EVENTS_MAX:
                yield f"{events} events are in the memory of the outbox"


SMALL: Final = ((outbox_module, "MEMORY_MAX", EVENTS_MAX),)  # attributes for a simulation
