from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from flows.graph import Flow, Stream
from flows.graph.node import check_extras
from flows.graph.testing import TestSink, TestSource
from flows.graph.validation import problems, validate
from operators import (
    EVERY,
    Debounce,
    FlowError,
    InputError,
    Join,
    Operator,
    ParameterError,
    Scores,
    Slips,
    Touch,
    Zero,
)  # fmt: skip
from tests.flows.run.live import flow_of


def _one_problem(flow: Flow) -> str:
    [problem] = problems(flow)
    assert "\n" not in str(problem)
    with pytest.raises(FlowError) as raised:
        validate(flow)
    assert str(raised.value) == str(problem)
    return f"{problem.edge}: {problem.reason}"


def test_a_flow_without_a_source_is_reported() -> None:
    assert "no source" in _one_problem(Flow("f"))


def test_a_wrong_type_is_named_first_with_its_edge_and_the_missing_operators() -> None:
    flow = Flow("f")
    touch: Stream[Any] = flow.source(TestSource(Touch))
    _ = touch | Zero()
    (touch | Debounce()).to(TestSink())
    found = [f"{each.edge}: {each.reason}" for each in problems(flow)]
    assert found[0] == "touch -> Debounce: Debounce takes Scores, not Touch: insert Zero and Score"
    assert found[1].startswith("Zero -> ?: its stream of Zeroed is unconnected")


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


@dataclass
class Loud(Operator[Scores, Scores]):
    def process(self, batch: Scores) -> Scores:
        return batch


@dataclass
class Sharing(Loud):
    seen: list[float] = field(default_factory=list[float])


@dataclass
class Collecting(Loud):
    seen = list[float]()  # noqa: RUF012 - the mistake
    TABLE = {"steel": 0.3}  # noqa: RUF012 - a constant


class Losing(Loud):
    def __init__(self, gain: float = 1.0) -> None:
        super().__init__()
        self.gain = gain


class Stateless(Loud):
    def __init__(self) -> None:
        self.last = 0.0


class Undecorated(Loud):
    _last: float = field(default=0.0, init=False)


@pytest.mark.parametrize(
    ("operator", "reason"),
    [
        (Undecorated(), "Undecorated: _last has no value: write @dataclass above class Undecorated"),
        (Sharing(), "Sharing: seen would be shared by all runs"),
        (Collecting(), "Collecting: seen would be shared by all runs"),
        (Losing(2.0), "Losing: gain would be lost: make it a field of a @dataclass"),
        (Stateless(), "Stateless: its __init__ lacks super().__init__(): use a @dataclass"),
    ],
    ids=["undecorated", "shared", "of the class", "lost", "no base"],
)
def test_an_operator_that_each_run_could_not_copy_is_reported(operator: Loud, reason: str) -> None:
    flow = flow_of(TestSource(Scores), TestSink(), through=[operator])
    assert _one_problem(flow).startswith(reason)
    assert type(operator).__name__ in str(flow)


def test_an_operator_that_copies_itself_may_have_its_own_arguments() -> None:
    class Own(Losing):
        def reset_copy(self) -> "Own":
            return Own(self.gain)

    assert problems(flow_of(TestSource(Scores), TestSink(), through=[Own(2.0)])) == []


def test_an_operator_without_types_is_reported() -> None:
    class Silent(Operator):  # type: ignore[type-arg]
        def process(self, batch: Scores) -> Scores:
            return batch

    flow = flow_of(TestSource(Scores), TestSink(), through=[Silent()])
    with pytest.raises(
        InputError, match=r"^Silent: declares no .*: write class Silent\(Operator\[Scores, Scores\]\)$"
    ):
        problems(flow)


def test_the_batch_parameter_of_a_sink_may_have_any_name() -> None:
    class Named(TestSink):
        async def write(self, slips: Slips) -> None:  # type: ignore[override]
            """Take them."""

    assert "takes Slips, not Scores" in _one_problem(flow_of(TestSource(Scores), Named()))


class Wrong:
    async def any_type(self, batch: object) -> None:
        """Take anything."""

    async def no_type(self, batch) -> None:  # type: ignore[no-untyped-def]  # noqa: ANN001 - wrong on purpose
        """Take anything."""

    def at_once(self, batch: Scores) -> None:
        """Take scores."""

    async def later(self, batch: Scores) -> bool:
        return True


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("write", Wrong.any_type, "lacks a batch type: annotate it, as in async def write(self, batch: "),
        ("write", Wrong.no_type, "lacks a batch type: annotate it"),
        ("write", Wrong.at_once, "write must be declared with async def"),
        ("open", lambda self, run: None, "open must be declared with async def"),
        ("close", lambda self: None, "close must be declared with async def"),
        ("take", Wrong.later, "take must be declared with def"),
        ("destination", lambda self: "here", "destination must be a text: make it an attribute or a "),
    ],
    ids=["any type", "no type", "write", "open", "close", "take", "destination"],
)
def test_a_sink_that_would_fail_in_a_run_is_reported(name: str, value: object, reason: str) -> None:
    kind = type("Own", (TestSink,), {name: value})
    assert _one_problem(flow_of(TestSource(Scores), kind())).startswith(f"scores -> own: {reason}")


def _yield_at_once(self: object, clock: object) -> Iterator[Scores]:
    yield Scores.zeros()


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("batches", _yield_at_once, "batches must be declared with async def and contain yield"),
        ("batches", Wrong.later, "batches must be declared with async def and contain yield"),
        ("fingers", 0, "fingers is 0, must be a tuple, such as (0,)"),
    ],
)
def test_a_source_that_would_fail_in_a_run_is_reported(name: str, value: object, reason: str) -> None:
    flow, kind = Flow("f"), type("Own", (TestSource,), {name: value})
    (flow.source(kind(Touch)) & flow.source(TestSource(Touch)) | Compare()).to(TestSink())
    assert _one_problem(flow) == f"touch: {reason}"


def test_a_type_that_only_type_checkers_import_is_named() -> None:
    class Unknown(TestSink):
        async def write(self, batch: "Missing") -> None:  # type: ignore[name-defined]  # noqa: F821
            """Take them."""

    flow = flow_of(TestSource(Scores), Unknown())
    with pytest.raises(InputError, match=r"^Unknown: name 'Missing' is not defined: import it outside "):
        problems(flow)


def test_an_extra_that_does_not_exist_is_an_error_with_those_that_do() -> None:
    sink = TestSink()
    sink.extra = "foo"
    with pytest.raises(ParameterError, match=r"^testsink: extra is 'foo', must be one of train, "):
        check_extras(flow_of(TestSource(Scores), sink).nodes)


def test_a_source_of_a_plain_dataclass_is_reported() -> None:
    @dataclass
    class Force:
        normal: float

    flow = flow_of(TestSource(Force), TestSink())
    with pytest.raises(ParameterError, match=r"TestSource: kind is .*Force.*, must be a batch type"):
        validate(flow)


@dataclass
class Compare(Join[Touch, Touch, Touch]):
    def process(self, left: Touch, right: Touch) -> Touch:
        return left


@pytest.mark.parametrize(("right", "fits"), [((1,), False), ((0, 1), True), ((EVERY,), True), ((), True)])
def test_joined_streams_without_common_fingertips_are_named(right: tuple[int, ...], *, fits: bool) -> None:
    flow = Flow("f")
    one = flow.source(TestSource(Touch, fingers=(0,)), "one")
    other = flow.source(TestSource(Touch, fingers=right), "other")
    (one & other | Compare()).to(TestSink())
    assert problems(flow, fingertips=False) == []
    if fits:
        assert problems(flow) == []
    else:
        assert "one & other -> Compare: fingertips [0] never meet [1]: join " in _one_problem(flow)
