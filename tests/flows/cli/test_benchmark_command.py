"""`slipflow benchmark`."""

from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest

from flows.cli.benchmark import benchmark
from flows.learn.benchmark import folds
from flows.learn.benchmark.entrants import REGIMES
from flows.learn.labelled_recordings import LabelledRecording
from operators import InputError
from operators.fingertip import Fingertip, grid
from storage.layout import DATASET


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
