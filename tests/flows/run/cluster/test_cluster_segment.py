from pathlib import Path

import pytest

from connectors import Console
from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.graph.testing import TestSource
from flows.run.cluster.cluster_segment import ResultSink, check_flow, needed_sources, result_nodes, segment
from operators import EVERY, Debounce, FlowError, Motion, Score, Touch, Zero
from storage import Dataset, load_detector

from .conftest import derive


def test_each_result_node_gets_a_result_sink(tmp_path: Path) -> None:
    flow = derive(tmp_path)
    assert [node.name for node in result_nodes(flow)] == ["Label", "Debounce"]
    part = segment(flow, {"touch": (0, 4), "motion": (EVERY,)})
    places = [node.part.operator for node in part.sinks() if isinstance(node.part, ResultSink)]
    assert [flow.nodes[place].name for place in places] == ["Label", "Debounce"]


def test_a_segment_has_the_fingertips_of_the_recording(tmp_path: Path) -> None:
    part = segment(derive(tmp_path), {"touch": (0, 4), "motion": (EVERY,)})
    assert {(node.name, finger) for node, finger in CompiledFlow(part).entries} == {
        ("touch", 0), ("touch", 4), ("motion", EVERY)
    }  # fmt: skip
    assert {(node.name, finger) for node, finger in CompiledFlow(part, only=(4,)).entries} == {
        ("touch", 4), ("motion", EVERY)
    }  # fmt: skip


def test_sources_that_only_feed_sinks_are_not_needed(tmp_path: Path) -> None:
    flow, dataset = Flow("f"), Dataset(tmp_path)
    (flow.source(TestSource(Touch)) | Zero() | Score(load_detector("psd")) | Debounce()).to(dataset)
    flow.source(TestSource(Motion)).to(dataset)
    assert needed_sources(flow) == {"touch"}
    assert [node.name for node in segment(flow, {"touch": (0,)}).sources()] == ["touch"]


def test_a_sink_other_than_a_dataset_is_an_error() -> None:
    flow = Flow("f")
    (flow.source(TestSource(Touch)) | Zero() | Score(load_detector("psd")) | Debounce()).to(Console())
    with pytest.raises(FlowError, match="console: a cluster writes datasets only"):
        check_flow(flow)


def test_a_flow_without_operators_before_datasets_is_an_error(tmp_path: Path) -> None:
    flow = Flow("f")
    flow.source(TestSource(Touch)).to(Dataset(tmp_path))
    with pytest.raises(FlowError, match="none takes the rows of an operator"):
        check_flow(flow)
