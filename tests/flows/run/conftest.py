"""Workers of both kinds."""

from collections.abc import Iterator
from concurrent.futures import Executor

import pytest

from flows.run.executor import workers


@pytest.fixture(params=["two processes", "two Dask workers"])
def two(request: pytest.FixtureRequest) -> Iterator[Executor | None]:
    local = request.param == "two processes"
    with workers(2) if local else workers(cluster=request.getfixturevalue("dask")) as executor:
        yield executor
