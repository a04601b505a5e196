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
from tests.flows.lab.recipes.source_format import BEGIN, grasps_csv, strokes_csv

FILES = {
    "data/one.csv": b"t,a,b\n" + b"".join(b"%.2f,%d,%d\n" % (i / 100, i % 9, i % 7) for i in range(60)),
    "two.csv": b"t,a,b\n" + b"".join(b"%.2f,%d,%d\n" % (i / 100, i % 5, 3) for i in range(40)),
}


def taps(files: Mapping[str, Path]) -> Iterator[SourceRecording]:
    for path, file in files.items():
        yield SourceRecording(Path(path).stem, pl.read_csv(file), group="cork")


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


@pytest.mark.usefixtures("source")
@pytest.mark.parametrize(
    "address", ["http://[::1", "http://host:port/x", "://", "ftp://x/y", "http://\u2100/", "%"]
)
def test_a_redirect_to_a_malformed_address_is_an_error(
    tmp_path: Path, recipe: DatasetRecipe, monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    def redirect(handler: Handler) -> None:
        handler.send_response(302)
        handler.send_header("Location", address.encode().decode("latin-1"))
        handler.end_headers()

    monkeypatch.setattr("flows.lab.recipes.dataset_recipe._ATTEMPTS", 0)
    monkeypatch.setattr(Handler, "do_GET", redirect)
    with pytest.raises(EndpointError, match="was not fetched: ") as caught:
        recipe.fetch(tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


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


@pytest.mark.parametrize(("recipe", "files"), [(strokes.STROKES, 47), (grasps.GRASPS, 21)])
def test_a_recipe_states_source_licence_and_checksums(recipe: DatasetRecipe, files: int) -> None:
    checksums = [line.split()[1] for line in recipe.registry.read_text().splitlines()]
    assert (len(checksums), {*map(len, checksums)}) == (files, {64})
    assert recipe.base_url.startswith("https://raw.githubusercontent.com/")
    assert all(text in recipe.text() for text in (recipe.licence, recipe.citation, recipe.page))


def test_strokes_have_six_cells_of_two_electrodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(0)
    electrodes = {f"e{each}": random.integers(2000, 3500, 400) for each in range(1, 20)}
    moving = np.where(np.arange(400) // 50 % 2, 0.4, 0.01) + random.normal(0, 0.003, 400)  # rad/s
    frame = pl.DataFrame({"t": np.arange(400) / 100, "w": moving, **electrodes})
    torn = strokes_csv(frame).splitlines(keepends=True)
    torn[100] = torn[100].replace(b"2", b"x")
    files = {"csv/still_vel1.csv": b"".join(torn), "csv/tkan_vel2_again.csv": strokes_csv(frame)}
    dataset = copied(strokes.STROKES, files, tmp_path, monkeypatch)
    damaged, whole = sessions(dataset).values()
    pairs: Reals = np.column_stack(
        [(electrodes[f"e{first + 1}"] + electrodes[f"e{second + 1}"]) / 2 for first, second in strokes.PAIRS]
    )
    np.testing.assert_array_equal(counts(whole), np.round(pairs - np.median(pairs, axis=0)))
    assert len(counts(damaged)) == 399
    rows = samples(whole)
    np.testing.assert_allclose(rows.speed, np.abs(moving) * 0.096, atol=1e-7)
    np.testing.assert_array_equal(rows.label, np.abs(moving) * 0.096 > 0.005)
    np.testing.assert_allclose((rows.time - BEGIN) / 1e9, frame["t"], atol=2e-9)
    assert [each.describe()["group"] for each in (damaged, whole)] == ["still", "tkan"]


def grasp_files(frames: Mapping[str, pl.DataFrame]) -> dict[str, bytes]:
    return {
        f"data_set/data_sample_{trial}/{name}": content
        for trial, frame in frames.items()
        for name, content in grasps_csv(frame).items()
    }


def test_grasps_join_the_files_of_a_trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(3)
    taxels = {
        f"s1_txl{i}_{axis}": random.integers(16000, 16400, 90).astype(np.float64)
        for i in range(1, 17)
        for axis in "xyz"
    }
    motion = {"vx": np.linspace(0, -0.1, 90), "vy": np.linspace(0, 0.2, 90)}
    label = (np.arange(90) > 70).astype(int)
    frame = pl.DataFrame({"t": np.arange(90) / 60, **motion, "label": label, **taxels})
    files = grasp_files({"trial": frame})
    [session] = sessions(copied(grasps.GRASPS, files, tmp_path, monkeypatch)).values()
    means: Reals = np.column_stack(
        [np.array([taxels[f"s1_txl{i}_z"] for i in group]).mean(axis=0) for group in grasps.TAXELS]
    )
    np.testing.assert_array_equal(counts(session), np.round((means - means[:10].mean(axis=0)) / 4))
    rows = samples(session)
    np.testing.assert_array_equal(rows.label, label)
    np.testing.assert_allclose(rows.speed, np.hypot(motion["vx"], motion["vy"]), atol=1e-7)
    files["data_set/data_sample_trial/slip_label.csv"] = b"slip,fail\n" + b"0.0,0.0\n" * 89
    with pytest.raises(InputError, match=r"slip_label\.csv: has 89 rows, .*robot_state\.csv has 90"):
        copied(grasps.GRASPS, files, tmp_path / "short", monkeypatch)
