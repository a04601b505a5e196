"""Files with valid checksums and invalid content."""

import json
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from copy import deepcopy
from dataclasses import asdict
from pathlib import Path
from shutil import copytree, rmtree
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators import SlipflowError
from storage import Session, files, load_debounce, load_detector, recover, verify
from storage.models import save_card, shipped
from storage.parts import Part, read_manifest, write_manifest
from tests.storage.made import STREAMS, leave, new_run, rows, side_by_side, write

ANY = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


BATCHES = side_by_side(3)


@pytest.fixture(scope="module", params=["killed", "closed"])
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Session of a killed or closed recorder."""
    root = tmp_path_factory.mktemp(request.param)
    if request.param == "closed":
        write(root / "data", new_run(), BATCHES).close()
        return root / "data/sessions/one"
    return leave(root / "data", new_run(), BATCHES)


def read(folder: Path) -> None:
    rows(folder, BATCHES, STREAMS)


def value_paths(content: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yield the paths of all values in a JSON object."""
    keys: list[str | int] = [*content] if type(content) is dict else [*range(len(content))]
    for key in keys:
        yield (*path, key)
        if isinstance(content[key], dict | list):
            yield from value_paths(content[key], (*path, key))


def changed(content: Any, data: st.DataObject) -> Any:
    """Return a copy with one value replaced or removed."""
    content = deepcopy(content)
    *path, last = data.draw(st.sampled_from(list(value_paths(content))))
    inner = content
    for key in path:
        inner = inner[key]
    if data.draw(st.booleans()):
        inner[last] = data.draw(ANY)
    else:
        del inner[last]
    return content


def use(path: Path, *works: Callable[[Path], object]) -> None:
    """Call functions that read a path; only typed errors may occur."""
    for work in works:
        with suppress(SlipflowError):
            work(path)


@contextmanager
def copied(folder: Path) -> Generator[Path]:
    """Yield a copy of a session, then read, verify and recover it."""
    copy = folder.with_name("copy")
    copytree(folder, copy)
    try:
        yield copy
        use(copy, verify, read, recover, Session.open, verify)
    finally:
        rmtree(copy)


@settings(max_examples=25)
@given(data=st.data())
def test_whatever_session_json_says_the_errors_are_typed(folder: Path, data: st.DataObject) -> None:
    with copied(folder) as copy:
        about = files.read_checked(copy / "session.json")
        files.put_checked(copy / "session.json", changed(about, data))


@settings(max_examples=25)
@given(data=st.data())
def test_whatever_a_manifest_lists_the_errors_are_typed(folder: Path, data: st.DataObject) -> None:
    with copied(folder) as copy:
        parts = list(read_manifest(copy).values())
        number = data.draw(st.integers(0, len(parts) - 1))
        column = data.draw(st.sampled_from(["path", "rows", "first", "last", "sha256"]))
        values = asdict(parts[number])
        values[column] = data.draw(ANY | st.sampled_from(["../x", "/etc/passwd", "slips.parquet", "0" * 64]))
        parts[number] = Part(**values)
        write_manifest(copy, parts)


@settings(max_examples=12)
@given(data=st.data())
def test_errors_of_any_card_are_typed(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    model = shipped("tcn")
    assert model
    path = tmp_path_factory.getbasetemp() / "tcn.safetensors"
    path.write_bytes(model.read_bytes())
    card: Any = json.loads(model.with_suffix(".json").read_text())
    save_card(path, changed({key: card[key] for key in ("sha256", "debounce", "detector")}, data))
    use(path, load_detector, load_debounce)
