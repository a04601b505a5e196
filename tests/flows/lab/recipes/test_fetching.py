import asyncio
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from flows.lab.recipes.dataset_recipe import DatasetRecipe, load_recipe
from flows.lab.recipes.fetched import DATASET, FILES, RECORD, fetched_dataset
from flows.lab.recipes.fetching import Fetched, fetch
from operators import EndpointError, InputError, Touch
from operators.batch import Reals
from storage import Session
from storage.files import read_json
from storage.lock import lock
from tests.flows.lab.recipes.source_format import (
    GROUPS,
    barometers_csv,
    copy_of,
    expected_strokes,
    grasps_csv,
    strokes_csv,
    strokes_frame,
)
from tests.flows.lab.recipes.source_server import recipe_of, serve

REAL = Path(__file__).parents[5] / "shared" / "real"
FILES_OF = {
    "data/one.csv": b"t,a,b\n" + b"".join(b"%.2f,%d,%d\n" % (i / 100, i % 9, i % 7) for i in range(60)),
    "two.csv": b"t,a,b\n" + b"".join(b"%.2f,%d,%d\n" % (i / 100, i % 5, 3) for i in range(40)),
}
RECIPE = recipe_of(FILES_OF)


def run(recipe: DatasetRecipe, folder: Path, files: Path | None = None, mirror: str | None = None) -> Fetched:
    return asyncio.run(fetch(recipe, folder, files=files, mirror=mirror))


def sessions(fetched: Fetched) -> dict[str, Session]:
    folders = sorted((fetched.dataset / "sessions").iterdir())
    return {folder.name: Session.open(folder) for folder in folders}


def samples(session: Session) -> pl.DataFrame:
    return session.frame("samples")


def counts(session: Session) -> list[list[int]]:
    return [row for batch in session.read(Touch, 0) for row in batch.counts.tolist()]


def converted(name: str) -> dict[str, pl.DataFrame]:
    if not (REAL / name).is_dir():
        pytest.skip(f"no real recordings at {REAL / name}: the recipe {name} is tested on drawn columns only")
    return {path.stem: pl.read_parquet(path) for path in sorted((REAL / name).glob("*.parquet"))}


def test_a_recipe_is_downloaded_verified_and_imported(tmp_path: Path) -> None:
    with serve(FILES_OF) as server:
        found = run(RECIPE, tmp_path, mirror=server.url)
    assert (found.loaded, found.imported) == (2, True)
    assert fetched_dataset(RECIPE, tmp_path) == found.dataset == tmp_path / "taps" / DATASET
    assert (tmp_path / "taps" / FILES / "data" / "one.csv").read_bytes() == FILES_OF["data/one.csv"]
    assert {name: len(counts(each)) for name, each in sessions(found).items()} == {"r0": 60, "r1": 40}
    assert counts(sessions(found)["r1"])[:6] == [[i % 5, 3] for i in range(6)]
    record = read_json(tmp_path / "taps" / RECORD)
    assert (record["licence"], record["citation"]) == ("none", "Someone, Taps, 2026")
    assert {each.name for each in (tmp_path / "taps").iterdir()} == {DATASET, FILES, RECORD}


def test_a_fetched_recipe_needs_neither_network_nor_source_files(tmp_path: Path) -> None:
    with serve(FILES_OF) as server:
        first = run(RECIPE, tmp_path, mirror=server.url)
    (tmp_path / "taps" / FILES / "two.csv").unlink()
    again = run(RECIPE, tmp_path, mirror="https://localhost:1/")
    assert (again.loaded, again.imported, again.contents) == (0, False, first.contents)


def test_an_interrupted_fetch_keeps_verified_files_and_has_no_dataset(tmp_path: Path) -> None:
    with serve(FILES_OF) as server:
        del server.files["two.csv"]
        with pytest.raises(EndpointError, match="404"):
            run(RECIPE, tmp_path, mirror=server.url)
        with pytest.raises(InputError, match="run `slipflow fetch taps"):
            fetched_dataset(RECIPE, tmp_path)
        server.files["two.csv"] = FILES_OF["two.csv"]
        assert run(RECIPE, tmp_path, mirror=server.url).loaded == 1


def test_a_killed_import_is_repeated(tmp_path: Path) -> None:
    half = tmp_path / "taps" / f"{DATASET}.partial" / "sessions" / "r0"
    half.mkdir(parents=True)
    with serve(FILES_OF) as server:
        found = run(RECIPE, tmp_path, mirror=server.url)
    assert [*sessions(found)] == ["r0", "r1"]


def test_another_version_of_the_recipe_replaces_the_dataset(tmp_path: Path) -> None:
    with serve(FILES_OF) as server:
        run(RECIPE, tmp_path, mirror=server.url)
        other = replace(RECIPE, derived={"c": "a + b"}, map={"time": "t", "counts": "c"})
        with pytest.raises(InputError, match="another version of the recipe"):
            fetched_dataset(other, tmp_path)
        found = run(other, tmp_path, mirror=server.url)
    assert (found.loaded, found.imported) == (0, True)
    assert counts(sessions(found)["r1"])[:6] == [[i % 5 + 3] for i in range(6)]


def test_files_of_a_clone_are_verified_and_imported_without_a_network(tmp_path: Path) -> None:
    clone = tmp_path / "clone"
    (clone / "data").mkdir(parents=True)
    (clone / "data" / "one.csv").write_bytes(FILES_OF["data/one.csv"])
    with pytest.raises(
        InputError, match=r"two\.csv: does not exist: get https://raw\.githubusercontent\.com/.*clone"
    ):
        run(RECIPE, tmp_path / "out", files=clone)
    (clone / "two.csv").write_bytes(FILES_OF["two.csv"].replace(b"3", b"4", 1))
    (clone / "data" / "one.csv").write_bytes(b"")
    with pytest.raises(InputError, match=r"one\.csv: differs from the source .* as do 1 others"):
        run(RECIPE, tmp_path / "out", files=clone)
    for path, data in FILES_OF.items():
        (clone / path).write_bytes(data)
    found = run(RECIPE, tmp_path / "out", files=clone)
    assert (found.loaded, found.files) == (0, clone)
    assert not (tmp_path / "out" / "taps" / FILES).exists()


def test_manually_downloaded_files_are_used(tmp_path: Path) -> None:
    for path, data in FILES_OF.items():
        file = tmp_path / "taps" / FILES / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    found = run(RECIPE, tmp_path, mirror="http://localhost:1")  # no server
    assert (found.loaded, found.imported) == (0, True)


def test_a_recipe_without_files_is_an_error_that_names_the_source(tmp_path: Path) -> None:
    only = replace(RECIPE, recordings=(), not_run_here=True)
    with pytest.raises(InputError, match=r"only documents a dataset.*github\.com/someone/taps"):
        run(only, tmp_path)


def test_two_fetches_of_one_recipe_exclude_each_other(tmp_path: Path) -> None:
    (tmp_path / "taps").mkdir()
    held = lock(tmp_path / "taps")
    assert held is not None
    with pytest.raises(EndpointError, match="in use by another `slipflow fetch`"):
        run(RECIPE, tmp_path)
    os.close(held)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"t,a\n0,1\n", "must have b"),
        (b"t,a,b\n0,x,1\n0.01,1,1\n", "two.csv, line 2, column a"),
        (b"t,a,b\n0,0.5,1\n0.01,1,1\n", "recipe taps, r1, row 0, column a"),
        (b"t,a,b\n0,1,1\n0.1,1,1\n0.2,1,1\n", "not 100"),
    ],
)
def test_a_source_file_with_invalid_values_is_an_error_that_names_them(
    content: bytes, expected: str, tmp_path: Path
) -> None:
    files = {**FILES_OF, "two.csv": content}
    with serve(files) as server, pytest.raises(InputError) as caught:
        run(recipe_of(files), tmp_path, mirror=server.url)
    assert expected in str(caught.value)
    assert {each.name for each in (tmp_path / "taps").iterdir()} == {FILES}


def test_rows_with_invalid_values_are_left_out_and_reported(tmp_path: Path) -> None:
    rows = [f"{i / 100},{i},{2 * i}".encode() for i in range(40)]
    rows[7], rows[8] = b"0.07,x,3", b"0.08,4"
    files = {"one.csv": b"t,a,b\n" + b"\n".join([*rows, b"0.40,4"])}
    with serve(files) as server:
        found = run(recipe_of(files, skip_invalid=True), tmp_path, mirror=server.url)
    assert counts(sessions(found)["r0"]) == [[i, 2 * i] for i in range(40) if i not in (7, 8)]
    assert found.contents["notes"][0] == "r0: 3 rows with invalid values left out"
    assert "note: r0: 3 rows" in found.text()


def test_the_recipe_of_the_strokes_reads_the_format_of_its_source(tmp_path: Path) -> None:
    frames = {name: strokes_frame(400, seed) for seed, name in enumerate(("still_vel1", "tkan_vel2"))}
    content = {name: {f"{name}.csv": strokes_csv(frame)} for name, frame in frames.items()}
    recipe = copy_of("strokes", content, tmp_path / "clone")
    found = run(recipe, tmp_path, files=tmp_path / "clone")
    for name, session in sessions(found).items():
        readings, speed, label = expected_strokes(frames[name])
        rows = samples(session)
        assert session.describe()["group"] == name.partition("_")[0]
        np.testing.assert_array_equal(counts(session), readings)
        np.testing.assert_allclose(rows["speed"], speed, atol=1e-7)
        np.testing.assert_array_equal(rows["label"], label)
        seconds = rows["time"].cast(pl.Int64).to_numpy() - 1508406493195955843
        np.testing.assert_allclose(seconds / 1e9, frames[name]["t"], atol=2e-9)
    assert found.contents["groups"] == ["still", "tkan"]
    assert "2 sessions, 2 surfaces" in found.text()


def test_the_recipe_of_the_grasps_joins_the_files_of_a_trial(tmp_path: Path) -> None:
    generator = np.random.default_rng(3)
    taxels: dict[str, Reals] = {
        f"s1_txl{i}_{axis}": generator.integers(16000, 16400, 90).astype(np.float64)
        for i in range(1, 17)
        for axis in "xyz"
    }
    motion = {"vx": np.linspace(0, -0.1, 90), "vy": np.linspace(0, 0.2, 90)}
    label = (np.arange(90) > 70).astype(int)
    frame = pl.DataFrame({"t": np.arange(90) / 60, **motion, "label": label, **taxels})
    name = load_recipe("grasps").recordings[0].name
    recipe = copy_of("grasps", {name: grasps_csv(frame)}, tmp_path / "clone")
    [session] = sessions(run(recipe, tmp_path, files=tmp_path / "clone")).values()
    means: Reals = np.column_stack(
        [np.array([taxels[f"s1_txl{i}_z"] for i in group]).mean(axis=0) for group in GROUPS]
    )
    baseline: Reals = means[:10].mean(axis=0)
    np.testing.assert_array_equal(counts(session), np.round((means - baseline) / 4))
    rows = samples(session)
    np.testing.assert_array_equal(rows["label"], label)
    np.testing.assert_allclose(rows["speed"], np.hypot(motion["vx"], motion["vy"]), atol=1e-7)


def test_files_of_a_trial_with_different_numbers_of_rows_are_an_error(tmp_path: Path) -> None:
    columns = {f"s1_txl{i}_{axis}": np.zeros(30) for i in range(1, 17) for axis in "xyz"}
    state = {name: np.zeros(30) for name in ("vx", "vy")}
    frame = pl.DataFrame({"t": np.arange(30) / 60, **state, "label": np.zeros(30), **columns})
    files = grasps_csv(frame)
    files["slip_label.csv"] = b"slip,fail\n" + b"0.0,0.0\n" * 29
    name = load_recipe("grasps").recordings[0].name
    recipe = copy_of("grasps", {name: files}, tmp_path / "clone")
    with pytest.raises(InputError, match=r"slip_label\.csv: has 29 rows, .*robot_state\.csv has 30"):
        run(recipe, tmp_path, files=tmp_path / "clone")


def test_the_recipe_of_the_barometers_stores_pascals(tmp_path: Path) -> None:
    generator = np.random.default_rng(4)
    pressures = 98000 + np.cumsum(generator.normal(0, 40, (600, 4)), axis=0).round(2)
    columns = {f"Sensor_{i}": pressures[:, i] for i in range(4)}
    frame = pl.DataFrame({**columns, "x": np.zeros(600), "z": np.zeros(600), "time": np.arange(600) / 16.4})
    name = load_recipe("barometers").recordings[0].name
    torn = barometers_csv(frame).splitlines(keepends=True)
    torn[300] = b"98000.25,2100,20\n"
    recipe = copy_of("barometers", {name: {f"{name}.csv": b"".join(torn)}}, tmp_path / "clone")
    found = run(recipe, tmp_path, files=tmp_path / "clone")
    [session] = sessions(found).values()
    tip = session.fingertip(Touch)
    assert tip is not None
    assert (tip.cells, tip.unit, tip.resolution) == (4, "Pa", 2.0)
    relative = np.delete(pressures - pressures[:10].mean(axis=0), 299, axis=0)
    np.testing.assert_allclose(np.multiply(counts(session), 2), relative, atol=1.0)
    assert "no labels" in found.text()
    assert found.contents["notes"][0].endswith("1 row with invalid values left out")


def test_the_strokes_are_as_converted(tmp_path: Path) -> None:
    frames = dict([*converted("strokes").items()][::6])
    content = {name: {f"{name}.csv": strokes_csv(frame)} for name, frame in frames.items()}
    found = run(copy_of("strokes", content, tmp_path / "clone"), tmp_path, files=tmp_path / "clone")
    for name, session in sessions(found).items():
        rows, frame = samples(session), frames[name]
        np.testing.assert_array_equal(counts(session), frame.select("^b[0-5]$").to_numpy())
        np.testing.assert_allclose(rows["speed"], frame["speed"], atol=1e-5)  # w has four decimals there
        assert (rows["label"].to_numpy() != frame["label"].to_numpy()).mean() < 0.002
        assert session.describe()["group"] == name.partition("_vel")[0]


def test_the_grasps_are_as_converted(tmp_path: Path) -> None:
    frames = {name.removeprefix("data_sample_"): frame for name, frame in converted("grasps").items()}
    content = {name: grasps_csv(frame) for name, frame in frames.items()}
    found = run(copy_of("grasps", content, tmp_path / "clone"), tmp_path, files=tmp_path / "clone")
    assert found.contents["labels"] == {"slip": 196, "static": 2195 - 196, "unknown": 0}
    for name, session in sessions(found).items():
        rows, frame = samples(session), frames[name]
        np.testing.assert_array_equal(counts(session), frame.select("^b[0-5]$").to_numpy())
        np.testing.assert_array_equal(rows["label"], frame["label"])
        np.testing.assert_allclose(rows["speed"], frame["arm_speed"], atol=2e-6)  # rounded there


def test_the_barometers_are_as_converted(tmp_path: Path) -> None:
    frames = dict([*converted("barometers").items()][12:20:3])
    content = {name: {f"{name}.csv": barometers_csv(frame)} for name, frame in frames.items()}
    found = run(copy_of("barometers", content, tmp_path / "clone"), tmp_path, files=tmp_path / "clone")
    for name, session in sessions(found).items():
        pressures = frames[name].drop_nulls().select("^Sensor_[0-3]$").to_numpy()
        relative = pressures - pressures[:10].mean(axis=0)
        np.testing.assert_allclose(np.multiply(counts(session), 2), relative, atol=1.0)
