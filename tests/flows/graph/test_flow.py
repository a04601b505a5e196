from collections.abc import Callable
from typing import Any

import pytest

from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from operators import Align, Debounce, FlowError, Motion, Scores, Touch, Zero
from tests.flows.run.live import flow_of


@pytest.mark.parametrize(("fingers", "joined"), [((0, 2), (0, 2)), ((-1,), (-1,))])
def test_a_stream_of_all_fingertips_joins_each_one(fingers: tuple[int, ...], joined: tuple[int, ...]) -> None:
    flow = Flow("f")
    touch = flow.source(TestSource(Touch, fingers=fingers)) | Zero()
    motion = flow.source(TestSource(Motion))
    assert (touch & motion | Align()).node.fingers == joined


def test_replacing_parts_leaves_the_flow_as_it_was() -> None:
    sink, other = TestSink(), TestSink()
    flow = flow_of(TestSource(Scores), sink, through=[Debounce()])
    drawn = str(flow)
    copy = flow.replaced(lambda node: other if node.part is sink else node.part)
    assert [node.part for node in copy.sinks()] == [other]
    assert [node.name for node in copy.nodes] == [node.name for node in flow.nodes]
    assert not set(copy.nodes) & {parent for node in flow.nodes for parent in node.inputs}
    assert str(flow) == drawn


def test_a_stream_that_is_sent_to_one_sink_twice_reaches_it_once() -> None:
    flow, sink = Flow("f"), TestSink()
    scores = flow.source(TestSource(Scores)).to(sink).to(sink)
    assert [node.inputs for node in flow.sinks()] == [[scores.node]]


def test_an_operator_or_source_in_the_place_of_a_stream_is_an_error_that_says_what_to_write() -> None:
    flow = Flow("f")
    touch, motion = flow.source(TestSource(Touch)), flow.source(TestSource(Motion))
    operator: Any = Zero()
    with pytest.raises(FlowError, match=r"Zero & motion: .* write \(stream \| Zero\(\)\) & motion$"):
        _ = touch | operator & motion
    with pytest.raises(FlowError, match=r"motion & Zero: .* write motion & \(stream \| Zero\(\)\)$"):
        _ = motion & operator
    pair: Any = touch & motion
    with pytest.raises(FlowError, match=r"Pair & motion: .* write \(left & right \| Align\(\)\) & motion$"):
        _ = pair & motion
    source: Any = TestSource(Touch)
    with pytest.raises(TypeError, match=r"^TestSource is not a stream: begin with flow\.source\(\.\.\.\)$"):
        _ = source | operator


def test_a_stream_of_another_flow_cannot_be_joined() -> None:
    motion, touch = Flow("f").source(TestSource(Motion), name="arm"), Flow("g").source(TestSource(Touch))
    with pytest.raises(FlowError, match=r"^flow 'f': arm & touch: touch belongs to flow 'g': declare both"):
        _ = motion & touch


class Half:
    def process(self, batch: Touch) -> Touch:
        return batch


class Rig:
    def __init__(self) -> None:
        self.rate, self.touch, self.motion = 100, TestSource(Touch), TestSource(Motion)


@pytest.mark.parametrize(
    ("use", "part", "message"),
    [
        ("operator", Zero, "touch -> Zero: Zero is a class: write Zero()"),
        ("operator", Half(), "touch -> Half: Half is not of type Operator: derive its class from Op"),
        ("operator", TestSink(), "touch -> TestSink: TestSink is of type Sink: write stream.to(TestSink())"),
        ("operator", Align(), "touch -> Align: Align is of type Join: write left & right | Align()"),
        ("join", Zero(), "touch & touch -> Zero: Zero is of type Operator: write stream | Zero()"),
        ("sink", TestSink, "touch -> TestSink: TestSink is a class: write TestSink()"),
        ("source", abs, "abs: abs is not of type Source: derive its class from Source[Out]"),
        ("source", Rig(), "Rig: Rig is not of type Source, but has touch, motion: write flow.source(rig.t"),
    ],
)
def test_a_part_of_a_wrong_kind_is_an_error_with_what_to_write(use: str, part: Any, message: str) -> None:
    flow = Flow("f")
    touch = flow.source(TestSource(Touch))
    uses: dict[str, Callable[[], object]] = {
        "source": lambda: flow.source(part),
        "operator": lambda: touch | part,
        "join": lambda: touch & touch | part,
        "sink": lambda: touch.to(part),
    }
    with pytest.raises(FlowError) as raised:
        uses[use]()
    assert str(raised.value).startswith(f"flow 'f': {message}")
