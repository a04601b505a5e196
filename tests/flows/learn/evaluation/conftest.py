from pathlib import Path

import pytest

from flows.learn.evaluation.evaluation_study import Evaluation, evaluate


@pytest.fixture(scope="session")
def found(tiny: Path) -> Evaluation:
    return evaluate(tiny, names=["psd", "logistic", "tcn"])
