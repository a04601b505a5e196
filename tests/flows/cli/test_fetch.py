import asyncio
import json
import signal
import subprocess
import threading
from pathlib import Path

import pytest

from flows.lab.recipes.dataset_recipe import SHIPPED, DatasetRecipe, load_recipe
from tests.command import SLIPFLOW, error, slipflow
from tests.flows.lab.recipes.source_server import recipe_of, serve
from tests.waiting import until

FILES = {"one.csv": b"t,a,b\n" + b"".join(b"%.2f,%d,%d\n" % (i / 100, i % 9, i % 7) for i in range(60))}


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def own_recipe(folder: Path) -> Path:
    recipe: DatasetRecipe = recipe_of(FILES)
    [file] = recipe.files
    path = folder / "taps.toml"
    path.write_text(
        f"""title = "Taps"
repository = "someone/taps"
commit = "{"b" * 40}"
licence = "CC-BY-4.0"
terms = "Name the authors."
citation = "Someone, Taps, 2026"
rate = 100.0
columns = {{ t = "t", a = "a", b = "b" }}
derived = {{ label = "a > 4" }}
map = {{ time = "t", counts = "a,b", label = "label" }}
[[recordings]]
name = "one"
files = [{{ path = "{file.path}", bytes = {file.bytes}, sha256 = "{file.sha256}" }}]
"""
    )
    return path


def test_without_a_name_the_recipes_are_listed_with_size_licence_and_citation() -> None:
    done = slipflow("fetch")
    assert done.returncode == 0
    for name in SHIPPED:
        recipe = load_recipe(name)
        assert f"{name}: {recipe.title}\n" in done.stdout
        assert f"cite: {recipe.citation}" in done.stdout
    assert "47 recordings, 122 MB; licence: none" in done.stdout
    listed = json.loads(slipflow("fetch", "--json").stdout)
    assert {each["name"]: each["licence"] for each in listed}["grasps"] == "MIT"


def test_an_own_recipe_is_fetched_and_its_licence_is_printed(tmp_path: Path) -> None:
    recipe = own_recipe(tmp_path)
    with serve(FILES) as server:
        done = slipflow("fetch", recipe, "--from", server.url, "--to", tmp_path / "data")
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "data" / "taps"
    for line in (
        "licence: CC-BY-4.0",
        "terms: Name the authors.",
        "cite: Someone, Taps, 2026",
        f"{folder}/files: 1 file, 0.5",
        f"{folder}/dataset: 1 session, 0.0 minutes; 25 slip, 35 static",
    ):
        assert line in done.stdout
    assert f"into {folder}" in done.stderr
    again = slipflow("fetch", recipe, "--to", tmp_path / "data", "--json")
    found = json.loads(again.stdout)
    assert (found["imported"], found["dataset"]) == (False, f"{folder}/dataset")
    assert slipflow("verify", folder / "dataset").returncode == 0


def test_ctrl_c_during_a_download_keeps_what_arrived(tmp_path: Path) -> None:
    recipe = own_recipe(tmp_path)
    partial = tmp_path / "data" / "taps" / "files" / "one.csv.partial"
    with serve(FILES) as server:
        server.cut["one.csv"], server.stall = [100], threading.Event()
        command = [*SLIPFLOW, "fetch", str(recipe), "--from", server.url, "--to", str(tmp_path / "data")]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        try:
            asyncio.run(until(lambda: partial.exists() and partial.stat().st_size == 100))
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=30)
        finally:
            server.stall.set()
            process.kill()
        assert process.returncode == 130, errors
        assert b"Traceback" not in errors
        assert slipflow("fetch", recipe, "--from", server.url, "--to", tmp_path / "data").returncode == 0
        assert server.requests[-1] == ("one.csv", "bytes=100-")


def test_the_default_folder_is_the_cache(tmp_path: Path) -> None:
    with serve(FILES) as server:
        done = slipflow("fetch", own_recipe(tmp_path), "--from", server.url)
    assert str(tmp_path / "cache" / "slipflow" / "taps" / "dataset") in done.stdout


def test_print_gives_the_recipe_as_a_template() -> None:
    assert slipflow("fetch", "strokes", "--print").stdout == SHIPPED["strokes"].read_text()


def test_a_recipe_that_only_documents_a_dataset_prints_what_is_known() -> None:
    done = slipflow("fetch", "pullouts")
    assert done.returncode == 2
    assert "not run here" in done.stdout
    assert "labels: none: load and travel" in done.stdout
    assert "only documents a dataset" in done.stderr
    assert slipflow("fetch", "pullouts", "--json").stdout == ""


def test_errors_are_one_line(tmp_path: Path) -> None:
    assert "recipe is 'stroke', must be one of" in error("fetch", "stroke")
    assert "begins with https://" in error_of_last("fetch", "grasps", "--from", "http://example.com")
    assert "does not exist, as do 20 others" in error_of_last("fetch", "grasps", "--files", tmp_path)


def error_of_last(*arguments: str | Path) -> str:
    done = slipflow(*arguments)
    assert done.returncode == 2
    return done.stderr.splitlines()[-1]
