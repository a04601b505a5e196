from pathlib import Path

import pytest

from connectors import Console
from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.graph.testing import TestSource
from flows.run.cluster.cluster_segment import Tap, check_flow, needed, segment, tapped
from operators import EVERY, Debounce, FlowError, Motion, Score, Touch, Zero
from storage import Dataset, load_detector

from .conftest import derive


def test_what_datasets_take_of_operators_is_tapped_by_place(tmp_path: Path) -> None:
    flow = derive(tmp_path)
    assert [node.name for node in tapped(flow)] == ["Label", "Debounce"]
    part = segment(flow, {"touch": (0, 4), "motion": (EVERY,)})
    places = [node.part.operator for node in part.sinks() if isinstance(node.part, Tap)]
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
    assert needed(flow) == {"touch"}
    assert [node.name for node in segment(flow, {"touch": (0,)}).sources()] == ["touch"]


def test_a_sink_that_is_no_dataset_is_refused_by_name() -> None:
    flow = Flow("f")
    (flow.source(TestSource(Touch)) | Zero() | Score(load_detector("psd")) | Debounce()).to(Console())
    with pytest.raises(FlowError, match="console: a cluster writes datasets only"):
        check_flow(flow)


def test_a_flow_that_derives_nothing_is_refused(tmp_path: Path) -> None:
    flow = Flow("f")
    flow.source(TestSource(Touch)).to(Dataset(tmp_path))
    with pytest.raises(FlowError, match="nothing that is derived"):
        check_flow(flow)
