"""Fixtures of several modules: a tiny simulated dataset, and a Dask cluster."""

import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from flows.lab.simulation import simulate
from tests.dask_cluster import two_workers


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a dataset of 12 recordings, 2 of them in the test split; all test processes share it."""
    base = tmp_path_factory.getbasetemp()
    out = (base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base) / "tiny"
    with out.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return out if out.exists() else simulate(out, "tiny", seed=0)


@pytest.fixture(scope="session")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """URL of a Dask scheduler with two workers, in processes of their own."""
    with two_workers(tmp_path_factory.mktemp("dask")) as cluster:
        yield cluster.url
