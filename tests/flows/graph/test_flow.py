import pytest

from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from operators import Align, Debounce, Motion, Sample, Scores, Slips, Touch, Zero


def test_a_stream_has_the_output_type_of_its_operator() -> None:
    flow = Flow("f")
    slips = flow.source(TestSource(Scores)) | Debounce()
    assert slips.node.gives is Slips
    assert slips.node.takes == (Scores,)


def test_a_join_takes_its_pair_in_order() -> None:
    flow = Flow("f")
    touch, motion = flow.source(TestSource(Touch)) | Zero(), flow.source(TestSource(Motion))
    joined = touch & motion | Align()
    assert joined.node.gives is Sample
    assert [node.gives for node in joined.node.inputs] == list(joined.node.takes)


def test_sources_of_one_kind_get_names_of_their_own() -> None:
    flow = Flow("f")
    assert [flow.source(TestSource(Touch)).node.name for _ in range(3)] == ["touch", "touch2", "touch3"]
    assert flow.source(TestSource(Touch), name="thumb").node.name == "thumb"


def test_one_sink_object_is_one_node_however_many_streams_it_takes() -> None:
    flow, sink = Flow("f"), TestSink()
    flow.source(TestSource(Touch)).to(sink)
    flow.source(TestSource(Motion)).to(sink)
    [node] = flow.sinks()
    assert [parent.name for parent in node.inputs] == ["touch", "motion"]


@pytest.mark.parametrize(("fingers", "joined"), [((0, 2), (0, 2)), ((-1,), (-1,))])
def test_a_stream_of_all_fingertips_joins_each_of_them(
    fingers: tuple[int, ...], joined: tuple[int, ...]
) -> None:
    flow = Flow("f")
    touch = flow.source(TestSource(Touch, fingers=fingers)) | Zero()
    motion = flow.source(TestSource(Motion))
    assert (touch & motion | Align()).node.fingers == joined


def test_replacing_parts_leaves_the_flow_as_it_was() -> None:
    flow, sink = Flow("f"), TestSink()
    (flow.source(TestSource(Scores)) | Debounce()).to(sink)
    drawn = str(flow)
    other = TestSink()
    copy = flow.replaced(lambda node: other if node.part is sink else node.part)
    assert [node.part for node in copy.sinks()] == [other]
    assert [node.name for node in copy.nodes] == [node.name for node in flow.nodes]
    assert not set(copy.nodes) & {parent for node in flow.nodes for parent in node.inputs}
    assert str(flow) == drawn
