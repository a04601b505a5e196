from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest

from flows.learn.evaluation import evaluation_study
from flows.learn.evaluation.evaluation_study import Evaluation, evaluate
from flows.learn.labelled_recordings import LabelledRecording
from tests.flows.learn.conftest import shaken

Having: TypeAlias = Callable[[Sequence[LabelledRecording]], Path]


@pytest.fixture(scope="session")
def found(tiny: Path) -> Evaluation:
    return evaluate(tiny, names=["psd", "logistic", "tcn"], speed=1e-4)


@pytest.fixture(scope="session")
def surfaces() -> list[LabelledRecording]:
    """Return three recordings on each of three surfaces."""
    label = (np.arange(700) // 100 % 2).astype(np.int8)
    return [
        shaken(10 * n + k, label, name=f"{group}-{k}", group=group)
        for n, group in enumerate(("steel", "wood", "wool"))
        for k in range(3)
    ]


@pytest.fixture
def having(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Having:
    """Return a function that makes a dataset of recordings and returns its folder."""

    def dataset(recordings: Sequence[LabelledRecording]) -> Path:
        monkeypatch.setattr(evaluation_study, "load", lambda *_args, **_named: list(recordings))
        return tmp_path / "strokes"

    return dataset
