"""Tests of the code on docs/how-to/extend.md; its operator passes the conformance suite."""

import asyncio
import inspect
import resource
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from flows.run.clocks import LoopClock
from operators import EndpointError, Run, Slips, Source, Touch
from tests.operators import test_conformance
from tests.pages import ROOT, block

PAGE = ROOT / "docs" / "how-to" / "extend.md"
OWED = [name for name in vars(test_conformance) if name.startswith("test_")]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Any]]:
    """Gives what a file of the page defines, with some text in it replaced."""

    def make(name: str, old: str = "", new: str = "") -> dict[str, Any]:
        text = block(PAGE, name)
        assert old in text
        module = ModuleType(name.removesuffix(".py"))
        monkeypatch.setitem(sys.modules, module.__name__, module)  # where pickle looks
        exec(text.replace(old, new) if old else text, vars(module))  # noqa: S102 - ours
        return vars(module)

    return make


@pytest.mark.parametrize("operator", [0, 1], ids=["ActiveRows", "MeasureActivity"])
@pytest.mark.parametrize(
    "name", [name for name in OWED if "case" in inspect.signature(getattr(test_conformance, name)).parameters]
)
def test_the_operators_pass_the_conformance_suite(
    name: str, operator: int, made: Callable[..., dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    defined = {**vars(test_conformance), **made("active_rows.py"), **made("activity.py")}
    case = eval(block(PAGE, "case").splitlines()[operator], defined)  # noqa: S307 - ours
    check = getattr(test_conformance, name)
    given = {"case": case, "monkeypatch": monkeypatch}
    check(**{key: given[key] for key in inspect.signature(check).parameters})


async def received(source: Source[Touch], sent: bytes) -> list[list[int]]:
    """Return the batches from a peer that sends these bytes and then closes the connection."""

    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(sent)
        await writer.drain()
        writer.close()

    counts = list[list[int]]()
    async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
        source.port = server.sockets[0].getsockname()[1]  # type: ignore[attr-defined]
        async for touch in source.batches(LoopClock()):
            assert touch.check().valid.all()
            counts += touch.counts.tolist()
    return counts


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (b"1 2 3 4 5 60", r"sent b'1 2 3 4 5 60', must be a whole line of 6 counts"),  # it may have been 600
        (b"1 2 3 4 5\n", "must be a whole line of 6 counts"),
        (b"99999 2 3 4 5 6\n", "from 0 to 1023"),
        (b"1 2 3 4 5 -6\n", "from 0 to 1023"),
        (b"\xff 2 3 4 5 6\n", "must be a whole line"),
        (b"1" * 5000, "sent a line of more than 1024 bytes"),
    ],
)
async def test_the_source_gives_whole_lines_and_refuses_others(
    sent: bytes, said: str, made: Callable[..., dict[str, Any]]
) -> None:
    source = made("lines.py")["LineTouch"]("127.0.0.1", 0)
    counts = await received(source, b"1 2 3 4 5 6\n0 0 0 0 0 1023\n")
    assert counts == [[1, 2, 3, 4, 5, 6], [0] * 5 + [1023]]
    with pytest.raises(EndpointError, match=said):
        await received(source, sent)


async def test_the_sink_takes_back_what_the_disk_had_no_room_for(
    tmp_path: Path, made: Callable[..., dict[str, Any]]
) -> None:
    sink = made("event_file.py")["EventFile"](tmp_path / "events.txt")
    time = np.array([5, 9])
    batch = Slips(time, np.array([1, 0], np.int8), time, np.full(2, 0.9), finger=0)
    full = len("# one\n" + "5 0 onset\n")  # bytes
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)

    await sink.open(Run("one", "own", LoopClock(), 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (full, most))
    try:
        with pytest.raises(EndpointError, match="cannot be written: No space left on device"):
            await sink.write(batch)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    await sink.write(batch)
    assert sink.path.read_text() == "# one\n5 0 onset\n9 0 end\n"
