import ctypes
from collections.abc import Callable
from types import SimpleNamespace

import pytest

from flows.run import host_checks
from flows.run.host_checks import clock_finding, package_findings, python_finding
from operators import extras
from operators.extras import Requirement


def test_python_versions_that_are_not_supported_are_noted() -> None:
    states = [python_finding(version).state for version in ((3, 10), (3, 11), (3, 13), (3, 14))]
    assert states == ["note", "good", "good", "note"]


def test_each_wrong_package_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    needed = (
        Requirement("numpy", "<1"),
        Requirement("nothing-like-it", ">=2"),
        Requirement("torch", ">=1", "train"),
    )
    monkeypatch.setattr(host_checks, "requirements", lambda: needed)
    monkeypatch.setattr(extras, "requirements", lambda: (*needed, Requirement("mo-torch", "", "train")))
    old, missing, train, *_ = package_findings()
    assert (old.subject, old.state, old.text.endswith("pip install 'numpy<1'")) == ("numpy", "bad", True)
    assert missing.text == "not installed, must be nothing-like-it>=2: pip install 'nothing-like-it>=2'"
    assert (train.subject, train.state) == ("extra train", "note")
    assert train.text.startswith("not installed; for training")


def test_a_small_installation_may_lack_what_it_does_not_need(hide_packages: Callable[..., None]) -> None:
    hide_packages("numba", "smbus2")
    states = {found.subject: found.state for found in package_findings()}
    assert (states["numba"], states["smbus2"], "slipflow" in states) == ("note", "bad", False)


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
