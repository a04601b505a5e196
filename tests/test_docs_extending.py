"""The operator of docs/extending.md owes what every operator owes; the other parts are what they say."""

import inspect
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from operators import Batch, Sink, Source
from operators.detectors import Detector
from tests.operators import conftest, test_conformance
from tests.pages import ROOT, block

PAGE = ROOT / "docs" / "extending.md"
OWED = [name for name in vars(test_conformance) if name.startswith("test_")]
same = conftest.same  # the fixture


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Any]]:
    """Gives what a file of the page defines, with some text in it replaced."""

    def make(name: str, old: str = "", new: str = "") -> dict[str, Any]:
        text = block(PAGE, name)
        assert old in text
        module = ModuleType(name.removesuffix(".py"))
        monkeypatch.setitem(sys.modules, module.__name__, module)  # where pickle looks
        exec(text.replace(old, new) if old else text, vars(module))  # noqa: S102 - ours
        return vars(module)

    return make


def case_of(defined: dict[str, Any]) -> test_conformance.Case:
    """The page's line for the table of the suite."""
    case: test_conformance.Case
    [case] = eval(f"[{block(PAGE, 'case')}]", {**vars(test_conformance), **defined})  # noqa: S307 - ours
    return case


@pytest.mark.parametrize(
    "name",
    [name for name in OWED if "case" in inspect.signature(getattr(test_conformance, name)).parameters],
)
def test_the_operator_passes_the_conformance_suite(
    name: str, made: Callable[..., dict[str, Any]], same: Callable[[Batch, Batch], None]
) -> None:
    check = getattr(test_conformance, name)
    given = {"case": case_of(made("stirring.py")), "same": same, "rows": 3_000}
    check(**{key: given[key] for key in inspect.signature(check).parameters})


@pytest.mark.parametrize("kept", ["batch.counts[-1:].copy()", "until.item(-1)"])
def test_the_suite_notices_if_the_operator_forgets(
    kept: str, made: Callable[..., dict[str, Any]], same: Callable[[Batch, Batch], None]
) -> None:
    forgets = made("stirring.py", kept, "None" if "copy" in kept else "-1")
    with pytest.raises(AssertionError):
        test_conformance.test_cutting_the_input_anywhere_changes_nothing(case=case_of(forgets), same=same)


def test_source_sink_and_detector_are_what_they_say(made: Callable[..., dict[str, Any]]) -> None:
    assert issubclass(made("lines.py")["LineTouch"], Source)
    assert issubclass(made("notes.py")["Notes"], Sink)
    detector: Detector = made("jerk.py")["Jerk"]()
    assert (detector.name, detector.length) == ("jerk", 20)
