"""What each kind of fault does to the world, and how its effect ends."""

from __future__ import annotations

import errno
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from tests.faults.schedule import Fault

if TYPE_CHECKING:
    from tests.faults.world import World

Effect: TypeAlias = "tuple[Callable[[World, Fault], object], Callable[[World], object] | None]"


def _set(name: str, value: Callable[[Fault], Any], rest: Any = 0) -> Effect:
    """Return an effect that sets an attribute of the world and later resets it."""
    owner, _, attribute = name.rpartition(".")

    def start(world: World, fault: Fault) -> None:
        setattr(getattr(world, owner) if owner else world, attribute, value(fault))

    def end(world: World) -> None:
        setattr(getattr(world, owner) if owner else world, attribute, rest)

    return start, end


def _with_device(name: str, value: Callable[[World, Fault], Any]) -> Effect:
    """Return an effect that sets an attribute of one of the devices."""
    return lambda world, fault: setattr(
        world.devices[int(fault.size * 1e6) % 2], name, value(world, fault)
    ), None


EFFECTS: Final[dict[str, Effect]] = {
    "kill rig": (lambda world, _: world.kill_rig(), None),
    "kill rig at disk operation": (
        lambda world, fault: setattr(world.disk, "kill_in", 1 + int(fault.size * 40 * world.schedule.span)),
        None,
    ),
    "kill consumer": (lambda world, _: world.kill_consumer(), None),
    "power loss": (lambda world, _: world.lose_power(), None),
    "disk full": _set("disk.error", lambda _: errno.ENOSPC),
    "disk error": _set("disk.error", lambda _: errno.EIO),
    "fsync error": _set("disk.fsync_error", lambda _: True, rest=False),
    "slow disk": _set("slow", lambda fault: 0.5 * fault.size, 0.0),
    "broker down": (lambda world, _: world.broker.stop(forget=False), lambda world: world.broker.start()),
    "broker restart without memory": (
        lambda world, _: world.broker.stop(forget=True),
        lambda world: world.broker.start(),
    ),
    "connections cut": (lambda world, _: world.broker.cut_all(), None),
    "slow network": _set("broker.delay", lambda fault: 0.2 * fault.size, 1e-3),
    "publish refused": _set(
        "broker.refused", lambda fault: {"event" if fault.size < 0.5 else "head"}, set[str]()
    ),
    "source fails": _with_device("failing", lambda *_: True),
    "source silent": _with_device("silent_until", lambda world, fault: world.loop.time() + fault.duration),
    "loop stalls": (lambda world, fault: world.stall(fault), None),
    "clock steps": (lambda world, fault: world.step_clock(fault), None),
}
