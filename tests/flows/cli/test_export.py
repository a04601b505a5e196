"""`slipflow export` in processes of its own."""

import json
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from storage import Session
from tests.command import error, slipflow
from tests.storage.made import session_names


@pytest.fixture(scope="module")
def lerobot(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """An exported LeRobot dataset and what the command printed."""
    folder = tmp_path_factory.mktemp("lerobot")
    done = slipflow("export", str(tiny), "out", "--to", "lerobot", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "out", json.loads(done.stdout.splitlines()[-1])


def test_a_dataset_becomes_a_lerobot_dataset(lerobot: tuple[Path, dict[str, Any]]) -> None:
    out, found = lerobot
    frames = pl.read_parquet(out / "data" / "*" / "*.parquet")
    info = json.loads((out / "meta" / "info.json").read_text())
    assert found["frames"] == info["total_frames"] == len(frames)
    assert found["episodes"] == 12
    assert found["splits"] == info["splits"] == {"train": "0:9", "validation": "9:10", "test": "10:12"}
    assert {"observation.state", "observation.pose", "action"} < set(found["features"])


def test_an_exported_lerobot_dataset_can_be_imported_again(
    lerobot: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    files = sorted((lerobot[0] / "data").rglob("*.parquet"))[:2]
    (tmp_path / "both").mkdir()
    pl.concat(map(pl.read_parquet, files)).write_parquet(tmp_path / "both/both.parquet")
    columns = (
        "time=timestamp,counts=observation.state0..observation.state5,velocity=action0..action5,label=label"
    )
    for given, names in (
        (files, ("file-000", "file-001")),
        ([tmp_path / "both/both.parquet"], ("both-1", "both-2")),
    ):
        out = tmp_path / names[0]
        done = slipflow("import", *given, out, "--map", f"{columns},units.counts=count,zeroed=true")
        assert done.returncode == 0, done.stderr
        assert session_names(out) == [*names]
        for path, name in zip(files, names, strict=True):
            touch = Session.open(out / "sessions" / name).frame("touch")
            assert touch["counts"].to_list() == pl.read_parquet(path)["observation.state"].to_list()


def test_a_dataset_becomes_a_file_for_each_session_or_one_session_one_file(
    tiny: Path, tmp_path: Path
) -> None:
    done = slipflow("export", str(tiny), "out", "--to", "mcap", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    names = session_names(tiny)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {f"{name}.mcap" for name in names}
    assert done.stdout.startswith("12 files, ")
    session = tiny / "sessions" / names[0]
    one = slipflow("export", str(session), "one.mcap", "--to", "mcap", "--json", cwd=tmp_path)
    assert list(json.loads(one.stdout)["files"]["one.mcap"]) == [
        "/touch/0",
        "/samples/0",
        "/episodes",
        "/truth/0",
        "/motion",
    ]
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "out" / f"{names[0]}.mcap").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "nowhere", "out", "--to", "lerobot"], "nowhere: there is no such folder"),
        (["export", "nowhere", "out", "--to", "rosbag"], "--to rosbag: give lerobot or mcap"),
        (["export", "nowhere", "out", "--to", "mcap", "--rate", "5"], "--rate requires --to lerobot"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(arguments: list[str], message: str, tmp_path: Path) -> None:
    assert message in error(*arguments, cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []
