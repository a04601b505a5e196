"""`slipflow benchmark` on fetched recipes."""

import asyncio
from pathlib import Path
from typing import get_type_hints

import pytest

from flows.cli.benchmark import (
    _datasets,  # pyright: ignore[reportPrivateUsage] - before any measurement
    benchmark,
)
from flows.lab.recipes.fetching import fetch
from flows.learn.benchmark.entrants import REGIMES
from operators import InputError
from tests.command import error
from tests.flows.lab.recipes.source_server import recipe_of

FILE = {"one.csv": b"t,a,b\n" + b"".join(b"%.2f,%d,%d\n" % (i / 100, i % 9, i % 7) for i in range(60))}


def fetched(folder: Path, name: str, **keys: object) -> Path:
    source = folder / "source"
    source.mkdir(exist_ok=True)
    (source / "one.csv").write_bytes(FILE["one.csv"])
    recipe = recipe_of(FILE, name=name, **keys)
    return asyncio.run(fetch(recipe, folder / "data", files=source)).dataset


@pytest.mark.parametrize("given", [["cork"], []])
def test_a_recipe_file_that_was_fetched_is_found_by_name_and_by_default(
    given: list[str], tmp_path: Path
) -> None:
    fetched(tmp_path, "unlabelled")
    cork = fetched(
        tmp_path, "cork", derived={"slip": "a > 4"}, map={"time": "t", "counts": "a,b", "label": "slip"}
    )
    assert _datasets(given, tmp_path / "data") == {"cork": cork}


def test_recipes_without_labels_are_left_out_unless_they_are_named(tmp_path: Path) -> None:
    taps = fetched(tmp_path, "taps")
    assert _datasets(["taps"], tmp_path / "data") == {"taps": taps}
    with pytest.raises(InputError, match="no labelled recipe was fetched"):
        _datasets([], tmp_path / "data")


def test_a_benchmark_that_fails_leaves_no_empty_folder(tmp_path: Path) -> None:
    fetched(tmp_path, "taps")
    complaint = error("benchmark", "taps", "--to", tmp_path / "data", cwd=tmp_path)
    assert "holds no labelled samples" in complaint
    assert not (tmp_path / "benchmark").exists()


def test_the_help_names_every_regime() -> None:
    [option] = get_type_hints(benchmark, include_extras=True)["regime"].__metadata__
    assert ", ".join(REGIMES) in option.help
