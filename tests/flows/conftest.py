"""What tests of several modules need: a tiny simulated dataset."""

from pathlib import Path

import pytest

from flows.simulate import simulate


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """12 recordings, 2 of them for tests."""
    return simulate(tmp_path_factory.mktemp("data") / "tiny", "tiny", seed=0, jobs=1).out
