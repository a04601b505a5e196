import hashlib
import threading
from collections.abc import Generator, Iterator, Mapping
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from connectors.files.column_map import ColumnMap
from flows.lab.recipes import grasps, strokes
from flows.lab.recipes.dataset_recipe import DatasetRecipe, SourceRecording
from operators import EndpointError, InputError, Touch
from operators.batch import Labelled, Reals, concat
from storage import Session

FILES = {
    "data/one.csv": b"t,a,b\n" + b"".join(b"%.2f,%d,%d\n" % (i / 100, i % 9, i % 7) for i in range(60)),
    "two.csv": b"t,a,b\n" + b"".join(b"%.2f,%d,%d\n" % (i / 100, i % 5, 3) for i in range(40)),
}


def taps(files: Mapping[str, Path]) -> Iterator[SourceRecording]:
    for path, file in files.items():
        yield Path(path).stem, pl.read_csv(file), "cork"


def put(folder: Path, files: Mapping[str, bytes]) -> Path:
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    return folder


class Handler(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's cache of slipflow, a folder of the test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "slipflow"


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[Path]:
    """Folder of the files, served on this machine."""
    folder = put(tmp_path / "source", FILES)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(folder))) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        monkeypatch.setattr(DatasetRecipe, "base_url", f"http://127.0.0.1:{server.server_address[1]}/")
        yield folder
        server.shutdown()
        thread.join()


@pytest.fixture
def recipe(tmp_path: Path) -> DatasetRecipe:
    registry = put(tmp_path, {"taps.txt": registry_of(FILES)}) / "taps.txt"
    columns = ColumnMap.parse("counts=a,b")
    return replace(grasps.GRASPS, name="taps", columns=columns, registry=registry, recordings=taps)


def registry_of(files: Mapping[str, bytes]) -> bytes:
    return "".join(f"{path} {hashlib.sha256(files[path]).hexdigest()}\n" for path in files).encode()


def sessions(dataset: Path) -> dict[str, Session]:
    return {folder.name: Session.open(folder) for folder in sorted((dataset / "sessions").iterdir())}


def counts(session: Session) -> Any:
    return concat(Touch, list(session.read(Touch, 0))).counts.tolist()


def samples(session: Session) -> Labelled:
    return concat(Labelled, list(session.read(Labelled, 0)))


def test_a_recipe_is_downloaded_verified_and_imported_and_needs_no_network_again(
    tmp_path: Path, source: Path, recipe: DatasetRecipe
) -> None:
    assert recipe.fetch(tmp_path / "out") == pytest.approx([0.59, 0.39])
    found = sessions(tmp_path / "out")
    assert {name: len(counts(each)) for name, each in found.items()} == {"one": 60, "two": 40}
    assert counts(found["two"])[:6] == [[i % 5, 3] for i in range(6)]
    about = found["one"].describe()
    assert about["group"] == "cork"
    assert '"licence": "MIT"' in (tmp_path / "out/sessions/one/session.json").read_text()
    (source / "two.csv").unlink()
    assert len(recipe.fetch(tmp_path / "again")) == 2


def test_a_missing_or_altered_file_is_an_error_and_leaves_no_dataset(
    tmp_path: Path, source: Path, cache: Path, recipe: DatasetRecipe, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flows.lab.recipes.dataset_recipe._ATTEMPTS", 0)
    (source / "two.csv").write_bytes(FILES["two.csv"].replace(b"3", b"4", 1))
    with pytest.raises(EndpointError, match=r"two\.csv: was not fetched: SHA256 hash of downloaded file"):
        recipe.fetch(tmp_path / "out")
    (source / "two.csv").unlink()
    with pytest.raises(EndpointError, match=rf"404 .*; repeat .*, or copy a clone of .* to {cache}/taps"):
        recipe.fetch(tmp_path / "out")
    monkeypatch.setattr(DatasetRecipe, "base_url", "http://127.0.0.1:1/")
    with pytest.raises(EndpointError, match=r"one\.csv: was not fetched: .*refused|Max retries"):
        replace(recipe, name="other").fetch(tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / "out.partial").exists()


# --- the recipes -----------------------------------------------------------------------------------------


def copied(
    recipe: DatasetRecipe, files: Mapping[str, bytes], out: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """Fetch a recipe whose source has other files from a clone in the cache; return the dataset."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(out / "cache"))
    put(out / "cache/slipflow" / recipe.name, files)
    put(out, {"registry.txt": registry_of(files)})
    replace(recipe, registry=out / "registry.txt").fetch(out / "out")
    return out / "out"


def test_strokes_have_six_cells_of_two_electrodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(0)
    electrodes = random.integers(2000, 3500, (400, 19))
    moving = np.where(np.arange(400) // 50 % 2, 0.4, 0.01) + random.normal(0, 0.003, 400)  # rad/s
    stamps = 1508406493195955843 + 10_000_000 * np.arange(400)  # ns
    columns: dict[str, object] = {"field.header.stamp": stamps, "field.FFJ4_process_value_dot": moving}
    columns |= {f"field.el{each}": electrodes[:, each] for each in range(19)}
    whole = pl.DataFrame(columns).write_csv().encode()
    torn = whole.splitlines(keepends=True)
    torn[100] = torn[100].replace(b"2", b"x")
    files = {"csv/still_vel1.csv": b"".join(torn), "csv/tkan_vel2_again.csv": whole}
    found = sessions(copied(strokes.STROKES, files, tmp_path, monkeypatch))
    damaged, session = found.values()
    pairs: Reals = electrodes[:, np.array(strokes.PAIRS)].mean(axis=2)
    np.testing.assert_array_equal(counts(session), np.round(pairs - np.median(pairs, axis=0)))
    assert len(counts(damaged)) == 399
    rows = samples(session)
    np.testing.assert_allclose(rows.speed, np.abs(moving) * 0.096, atol=1e-7)
    np.testing.assert_array_equal(rows.label, np.abs(moving) * 0.096 > 0.005)
    np.testing.assert_array_equal(rows.time, stamps)
    assert [each.describe()["group"] for each in found.values()] == ["still", "tkan"]


def test_grasps_join_the_files_of_a_trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taxels = np.random.default_rng(3).integers(16000, 16400, (90, 16)).astype(np.float64)
    vx, vy = np.linspace(0, -0.1, 90), np.linspace(0, 0.2, 90)
    label = (np.arange(90) > 70).astype(int)
    frames = {
        "robot_state": pl.DataFrame({"v_x": vx, "v_y": vy, "time": np.arange(90) / 60}),
        "slip_label": pl.DataFrame({"slip": label * 1.0}),
        "xela_sensor1": pl.DataFrame({f"txl{each + 1}_z": taxels[:, each] for each in range(16)}),
    }
    folder = "data_set/data_sample_trial"
    files = {f"{folder}/{name}.csv": frame.write_csv().encode() for name, frame in frames.items()}
    [session] = sessions(copied(grasps.GRASPS, files, tmp_path, monkeypatch)).values()
    groups = [[each - 1 for each in group] for group in grasps.TAXELS]
    means: Reals = np.column_stack([taxels[:, group].mean(axis=1) for group in groups])
    np.testing.assert_array_equal(counts(session), np.round((means - means[:10].mean(axis=0)) / 4))
    rows = samples(session)
    np.testing.assert_array_equal(rows.label, label)
    np.testing.assert_allclose(rows.speed, np.hypot(vx, vy), atol=1e-7)
    files[f"{folder}/slip_label.csv"] = frames["slip_label"][:89].write_csv().encode()
    with pytest.raises(InputError, match=r"slip_label\.csv: has 89 rows, .*robot_state\.csv has 90"):
        copied(grasps.GRASPS, files, tmp_path / "short", monkeypatch)
