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
from flows.lab.recipes.dataset_recipe import DatasetRecipe, Locate, SourceRecording
from flows.lab.recipes.fetching import RECIPES, fetch
from operators import EndpointError, InputError, Touch
from operators.batch import Labelled, Reals, concat
from storage import Session
from tests.flows.lab.recipes.source_format import BEGIN, grasps_csv, strokes_csv

REAL = Path(__file__).parents[5] / "shared" / "real"
FILES = {
    "data/one.csv": b"t,a,b\n" + b"".join(b"%.2f,%d,%d\n" % (i / 100, i % 9, i % 7) for i in range(60)),
    "two.csv": b"t,a,b\n" + b"".join(b"%.2f,%d,%d\n" % (i / 100, i % 5, 3) for i in range(40)),
}


def taps(locate: Locate) -> Iterator[SourceRecording]:
    for path in FILES:
        yield SourceRecording(Path(path).stem, pl.read_csv(locate(path)), group="cork")


RECIPE = replace(
    RECIPES["grasps"],
    name="taps",
    columns=ColumnMap.parse("counts=a,b"),
    registry={path: hashlib.sha256(content).hexdigest() for path, content in FILES.items()},
    recordings=taps,
)


def put(folder: Path, files: Mapping[str, bytes]) -> Path:
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    return folder


class Handler(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[tuple[Path, str]]:
    """Folder of the files, and its address on this machine; the cache is a folder of the test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = put(tmp_path / "source", FILES)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(folder))) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield folder, f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join()


def sessions(dataset: Path) -> dict[str, Session]:
    return {folder.name: Session.open(folder) for folder in sorted((dataset / "sessions").iterdir())}


def counts(session: Session) -> Any:
    return concat(Touch, list(session.read(Touch, 0))).counts.tolist()


def samples(session: Session) -> Labelled:
    return concat(Labelled, list(session.read(Labelled, 0)))


def test_a_recipe_is_downloaded_verified_and_imported(tmp_path: Path, source: tuple[Path, str]) -> None:
    done = fetch(RECIPE, tmp_path / "out", source[1])
    assert (done.sessions, done.groups) == (2, {"cork"})
    assert done.seconds == pytest.approx(0.98)
    found = sessions(tmp_path / "out")
    assert {name: len(counts(each)) for name, each in found.items()} == {"one": 60, "two": 40}
    assert counts(found["two"])[:6] == [[i % 5, 3] for i in range(6)]
    about = found["one"].describe()
    assert about["group"] == "cork"
    assert '"licence": "MIT"' in (tmp_path / "out/sessions/one/session.json").read_text()


def test_verified_files_are_not_downloaded_again(tmp_path: Path, source: tuple[Path, str]) -> None:
    fetch(RECIPE, tmp_path / "out", source[1])
    (source[0] / "two.csv").unlink()
    assert fetch(RECIPE, tmp_path / "again", source[1]).sessions == 2


def test_a_missing_or_altered_file_is_an_error_and_leaves_no_dataset(
    tmp_path: Path, source: tuple[Path, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flows.lab.recipes.fetching._ATTEMPTS", 0)
    folder, url = source
    (folder / "two.csv").write_bytes(FILES["two.csv"].replace(b"3", b"4", 1))
    with pytest.raises(EndpointError, match=r"two\.csv: was not fetched: SHA256 hash of downloaded file"):
        fetch(RECIPE, tmp_path / "out", url)
    (folder / "two.csv").unlink()
    with pytest.raises(EndpointError, match=r"404 .*: repeat|404.*; repeat the command, or give a copy of"):
        fetch(RECIPE, tmp_path / "out", url)
    with pytest.raises(EndpointError, match=r"one\.csv: was not fetched: .*refused|Max retries"):
        fetch(replace(RECIPE, name="other"), tmp_path / "out", "http://127.0.0.1:1")
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / "out.partial").exists()


def test_a_copy_of_the_source_needs_no_network(tmp_path: Path) -> None:
    clone = put(tmp_path / "clone", FILES)
    assert fetch(RECIPE, tmp_path / "out", str(clone)).sessions == 2
    (clone / "two.csv").write_bytes(b"")
    with pytest.raises(InputError, match=r"two\.csv: differs from the file in https://github\.com/imanlab"):
        fetch(RECIPE, tmp_path / "other", str(clone))
    (clone / "two.csv").unlink()
    with pytest.raises(InputError, match=r"two\.csv: does not exist: .* must be like a clone"):
        fetch(RECIPE, tmp_path / "other", str(clone))


# --- the recipes -----------------------------------------------------------------------------------------


def copied(
    recipe: DatasetRecipe, files: Mapping[str, bytes], out: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """Fetch a recipe whose source has other files; return the dataset."""
    registry = {path: hashlib.sha256(content).hexdigest() for path, content in files.items()}
    monkeypatch.setattr(f"flows.lab.recipes.{recipe.name}._REGISTRY", registry)
    clone = put(out / "clone", files)
    fetch(replace(recipe, registry=registry), out / "out", str(clone))
    return out / "out"


def converted(name: str) -> dict[str, pl.DataFrame]:
    if not (REAL / name).is_dir():
        pytest.skip(f"no real recordings at {REAL / name}: the recipe {name} is tested on drawn columns only")
    return {path.stem: pl.read_parquet(path) for path in sorted((REAL / name).glob("*.parquet"))}


@pytest.mark.parametrize(("name", "files"), [("strokes", 47), ("grasps", 21)])
def test_a_recipe_states_source_licence_and_checksums(name: str, files: int) -> None:
    recipe = RECIPES[name]
    assert len(recipe.registry) == files
    assert all(len(sha256) == 64 for sha256 in recipe.registry.values())
    assert recipe.base_url.startswith("https://raw.githubusercontent.com/")
    assert all(str(value) in recipe.text() for value in (recipe.licence, recipe.terms, recipe.citation))


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


def test_the_real_strokes_are_as_converted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = dict([*converted("strokes").items()][::6])
    files = {f"csv/{name}.csv": strokes_csv(frame) for name, frame in frames.items()}
    for name, session in sessions(copied(strokes.STROKES, files, tmp_path, monkeypatch)).items():
        rows, frame = samples(session), frames[name]
        np.testing.assert_array_equal(counts(session), frame.select("^b[0-5]$").to_numpy())
        np.testing.assert_allclose(rows.speed, frame["speed"], atol=1e-5)  # w has four decimals there
        assert (rows.label != frame["label"].to_numpy()).mean() < 0.002


def test_the_real_grasps_are_as_converted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = {name.removeprefix("data_sample_"): frame for name, frame in converted("grasps").items()}
    found = sessions(copied(grasps.GRASPS, grasp_files(frames), tmp_path, monkeypatch))
    assert sum(int(samples(each).label.sum()) for each in found.values()) == 196
    for name, session in found.items():
        rows, frame = samples(session), frames[name]
        np.testing.assert_array_equal(counts(session), frame.select("^b[0-5]$").to_numpy())
        np.testing.assert_array_equal(rows.label, frame["label"])
        np.testing.assert_allclose(rows.speed, frame["arm_speed"], atol=2e-6)  # rounded there
