import ctypes
from collections.abc import Callable
from types import SimpleNamespace

import pytest

from flows.run.host_checks import clock_finding, package_findings, python_finding


def test_python_versions_that_are_not_supported_are_noted() -> None:
    states = [python_finding(version).state for version in ((3, 10), (3, 11), (3, 13), (3, 14))]
    assert states == ["note", "good", "good", "note"]


def test_missing_packages_are_noted_with_their_remedy(hide_packages: Callable[..., None]) -> None:
    hide_packages("numba", "torch")
    found = {each.subject: each for each in package_findings()}
    assert (found["slipflow"].state, found["numba"].state) == ("good", "note")
    assert found["extra train"].text.startswith("not installed; for training")
    assert found["extra report"].text.startswith("matplotlib ")
    assert "polars" not in found


@pytest.mark.parametrize(("result", "state"), [(0, "good"), (5, "bad"), (-1, "note")])
def test_a_clock_that_is_not_synchronised_is_bad(
    result: int, state: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def adjtimex(_: object) -> int:
        return result

    def library(_: object) -> SimpleNamespace:
        return SimpleNamespace(adjtimex=adjtimex)

    monkeypatch.setattr(ctypes, "CDLL", library)
    assert clock_finding().state == state


def test_this_machines_clock_can_be_read() -> None:
    assert clock_finding().state in ("good", "bad")
