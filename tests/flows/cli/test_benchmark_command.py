"""`slipflow benchmark` on fetched recipes."""

import asyncio
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest

from flows.cli.benchmark import (
    _datasets,
    benchmark,
)
from flows.lab.recipes.fetching import fetch
from flows.learn.benchmark import folds
from flows.learn.benchmark.entrants import REGIMES
from flows.learn.labelled_recordings import LabelledRecording
from operators import InputError
from operators.fingertip import Fingertip, grid
from storage.layout import DATASET
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


def test_a_dataset_without_a_result_is_an_error_after_the_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def load(_: Path, _rate: float | None = None) -> list[LabelledRecording]:
        label, counts = (np.arange(400) // 100 % 2).astype(np.int8), np.zeros((400, 4), np.int16)
        tip = Fingertip(grid(4), 100.0)
        return [LabelledRecording(counts, label, "", name=name, fingertip=tip) for name in ("one", "two")]

    monkeypatch.setattr(folds, "load", load)
    (tmp_path / "four").mkdir()
    (tmp_path / "four" / DATASET).touch()
    with pytest.raises(InputError, match="four: no detector could be evaluated, for the reasons above"):
        benchmark(
            [str(tmp_path / "four")], regime=["zero-shot"], method=["tcn"], jobs=1, out=tmp_path / "report"
        )
    assert "four: no zero-shot tcn: tcn needs 6 cells" in capsys.readouterr().err
    assert (tmp_path / "report" / "benchmark.md").exists()
