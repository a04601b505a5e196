import json
from pathlib import Path

import pytest

from flows.lab.recipes.dataset_recipe import load_recipe
from flows.lab.recipes.fetched import DATASET, RECORD, cache_folder, fetched_dataset, recipe_folder
from operators import InputError

RECIPE = load_recipe("grasps")


def test_the_cache_follows_the_xdg_specification(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "slipflow"
    assert recipe_folder(RECIPE) == tmp_path / "slipflow" / "grasps"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert cache_folder() == Path.home() / ".cache" / "slipflow"


def test_a_recipe_that_was_not_fetched_is_an_error_that_names_the_command(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"recipe grasps was not fetched: run `slipflow fetch grasps --to .*` first"
    ):
        fetched_dataset(RECIPE, tmp_path)


def test_a_dataset_of_the_same_recipe_is_found(tmp_path: Path) -> None:
    folder = tmp_path / "grasps"
    folder.mkdir()
    (folder / RECORD).write_text(json.dumps({"recipe": RECIPE.digest}))
    with pytest.raises(InputError, match="was not fetched"):  # the dataset was deleted
        fetched_dataset(RECIPE, tmp_path)
    (folder / DATASET).mkdir()
    assert fetched_dataset(RECIPE, tmp_path) == folder / DATASET


def test_a_dataset_of_another_version_is_an_error(tmp_path: Path) -> None:
    folder = tmp_path / "grasps"
    (folder / DATASET).mkdir(parents=True)
    (folder / RECORD).write_text(json.dumps({"recipe": "0"}))
    with pytest.raises(InputError, match="another version of the recipe"):
        fetched_dataset(RECIPE, tmp_path)
