import os
from pathlib import Path

import pytest

from connectors.mqtt.outbox_place import boot, default_path, lock
from operators.errors import EndpointError


def test_every_rig_has_a_file_of_its_own_and_none_leaves_the_folder(
    state: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = [
        ("a", "b"),
        ("a-b", "c"),
        ("a", "b-c"),
        ("..", ".."),
        ("x" * 300, "y"),
        ("x" * 300, "z"),
        ("ü", "~"),
    ]
    paths = [default_path(*place) for place in places]
    assert len(set(paths)) == len(places)
    assert all(path.parent == state / "slipflow" and len(path.name.encode()) < 250 for path in paths)
    monkeypatch.setenv("XDG_STATE_HOME", "relative")
    assert default_path("a", "b") == Path.home() / ".local" / "state" / "slipflow" / "a-b.sqlite"


def test_only_one_may_hold_it(tmp_path: Path) -> None:
    held = lock(tmp_path / "o.sqlite")
    with pytest.raises(EndpointError, match=r"o\.sqlite: is in use: two runs may not publish as one rig"):
        lock(tmp_path / "o.sqlite")
    os.close(held)
    os.close(lock(tmp_path / "o.sqlite"))


def test_where_the_start_of_the_system_is_not_known_each_is_a_new_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(path: Path, **_: str) -> str:
        raise FileNotFoundError(path)

    monkeypatch.setattr(Path, "read_text", fail)
    assert boot() != boot()
