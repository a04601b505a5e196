from dataclasses import dataclass, field
from typing import Any

import pytest

from flows.graph import Flow, Stream
from flows.graph.testing import TestSink, TestSource
from flows.graph.validation import problems, validate
from operators import (
    Align,
    Debounce,
    FlowError,
    Motion,
    Operator,
    ParameterError,
    Scores,
    Slips,
    Touch,
    Zero,
)


def _one_problem(flow: Flow) -> str:
    [problem] = problems(flow)
    assert "\n" not in str(problem)
    with pytest.raises(FlowError) as raised:
        validate(flow)
    assert str(raised.value) == str(problem)
    return f"{problem.edge}: {problem.reason}"


def test_a_flow_without_a_source_is_reported() -> None:
    assert "no source" in _one_problem(Flow("f"))


def test_an_unconnected_stream_is_named() -> None:
    flow = Flow("f")
    _ = flow.source(TestSource(Touch)) | Zero()
    assert _one_problem(flow).startswith("Zero -> ?: its stream of Zeroed is unconnected")


def test_a_wrong_type_names_the_edge_both_types_and_the_missing_operators() -> None:
    flow = Flow("f")
    touch: Stream[Any] = flow.source(TestSource(Touch))
    (touch | Debounce()).to(TestSink())
    assert _one_problem(flow) == "touch -> Debounce: Debounce takes Scores, not Touch: insert Zero and Score"


def test_two_sinks_with_one_destination_are_reported() -> None:
    flow = Flow("f")
    scores = flow.source(TestSource(Scores))
    scores.to(TestSink(destination="/data"))
    (scores | Debounce()).to(TestSink(destination="/data"))
    message = _one_problem(flow)
    assert "Debounce -> testsink2" in message
    assert "/data" in message
    assert "scores -> testsink" in message


def test_a_sink_takes_two_streams_of_one_type_only_from_different_fingertips() -> None:
    flow, sink = Flow("f"), TestSink()
    flow.source(TestSource(Touch, fingers=(0,))).to(sink)
    flow.source(TestSource(Touch, fingers=(1,))).to(sink)
    assert problems(flow) == []
    flow.source(TestSource(Touch, fingers=(1,))).to(sink)
    assert _one_problem(flow) == "touch3 -> testsink: already receives Touch (from touch2): use another sink"


def test_one_operator_object_used_twice_is_reported() -> None:
    flow, shared = Flow("f"), Debounce()
    scores = flow.source(TestSource(Scores))
    (scores | shared).to(TestSink())
    (scores | shared).to(TestSink())
    assert "scores -> Debounce: the same operator object is used twice" in _one_problem(flow)


def test_a_stream_of_another_flow_is_reported() -> None:
    flow, other = Flow("f"), Flow("g")
    zeroed = other.source(TestSource(Touch)) | Zero()
    motion = flow.source(TestSource(Motion), name="arm")
    mixed: Any = motion & zeroed
    (mixed | Align()).to(TestSink())
    assert any("Zero belongs to another flow" in str(problem) for problem in problems(flow))


def test_state_shared_by_runs_is_reported() -> None:
    @dataclass
    class Sharing(Operator[Scores, Scores]):
        seen: list[float] = field(default_factory=list[float])

        def process(self, batch: Scores) -> Scores:
            return batch

    flow = Flow("f")
    (flow.source(TestSource(Scores)) | Sharing()).to(TestSink())
    assert _one_problem(flow).startswith("Sharing: seen would be shared by all runs")


@dataclass
class Loud(Operator[Scores, Scores]):
    def process(self, batch: Scores) -> Scores:
        return batch


def test_an_operator_whose_copies_would_lose_an_argument_is_reported() -> None:
    class Own(Loud):
        def __init__(self, gain: float = 1.0) -> None:
            super().__init__()
            self.gain = gain

    flow = Flow("f")
    (flow.source(TestSource(Scores)) | Own(2.0)).to(TestSink())
    assert _one_problem(flow).startswith("Own: gain would be lost: make it a field of a @dataclass")


def test_an_operator_that_copies_itself_may_have_its_own_arguments() -> None:
    class Own(Loud):
        def __init__(self, gain: float) -> None:
            super().__init__()
            self.gain = gain

        def reset_copy(self) -> "Own":
            return Own(self.gain)

    flow = Flow("f")
    (flow.source(TestSource(Scores)) | Own(2.0)).to(TestSink())
    assert problems(flow) == []


def test_an_operator_without_types_is_reported() -> None:
    class Silent(Operator):  # type: ignore[type-arg]
        def process(self, batch: Scores) -> Scores:
            return batch

    flow = Flow("f")
    (flow.source(TestSource(Scores)) | Silent()).to(TestSink())
    with pytest.raises(ParameterError, match=r"as in class Silent\(Operator\[Scores, Scores\]\)"):
        problems(flow)


def test_the_batch_parameter_of_a_sink_may_have_any_name() -> None:
    class Named(TestSink):
        async def write(self, slips: Slips) -> None:  # type: ignore[override]
            """Take them."""

    flow = Flow("f")
    scores: Stream[Any] = flow.source(TestSource(Scores))
    scores.to(Named())
    assert "takes Slips, not Scores" in _one_problem(flow)


def test_a_sink_without_a_type_annotation_is_reported() -> None:
    class Untyped(TestSink):
        async def write(self, batch: object) -> None:
            """Take anything."""

    flow = Flow("f")
    flow.source(TestSource(Scores)).to(Untyped())
    with pytest.raises(ParameterError, match="Untyped: the annotation of write"):
        validate(flow)


def test_a_source_of_a_plain_dataclass_is_reported() -> None:
    @dataclass
    class Force:
        normal: float

    flow, kind = Flow("f"), Force
    flow.source(TestSource(kind)).to(TestSink())  # type: ignore[type-var, arg-type]  # wrong on purpose
    with pytest.raises(ParameterError, match=r"TestSource: kind is .*Force.*, must be a batch type"):
        validate(flow)
