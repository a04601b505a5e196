"""What tests of several modules need: a tiny simulated dataset, and a flow to be shown."""

from pathlib import Path

import pytest

from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from flows.lab.simulation import simulate
from operators import Align, Label, Motion, Touch, Zero, ms


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """12 recordings, 2 of them for tests."""
    return simulate(tmp_path_factory.mktemp("data") / "tiny", "tiny", seed=0, jobs=1).out


@pytest.fixture
def drawn() -> Flow:
    """A flow in which one stream goes two ways, and a sink takes two streams."""
    flow, sink = Flow("drawn"), TestSink()
    touch = flow.source(TestSource(Touch))
    motion = flow.source(TestSource(Motion))
    zeroed = touch | Zero(baseline=400)
    (zeroed & motion | Align(within=10 * ms) | Label()).to(sink)
    zeroed.to(sink)
    return flow
