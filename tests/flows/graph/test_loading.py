import pickle
import sys
from pathlib import Path
from types import FunctionType

import pytest

from flows.graph import Flow
from flows.graph.loading import load
from operators import InputError

GOOD = """
from flows.graph import Flow
from flows.graph.testing import TestSink, TestSource
from operators import Scores

def pressed(
    threshold: float = 0.5, count: int = 2, name: str = "pressed", fast: bool = False, out: str | None = None
) -> Flow:
    flow = Flow(f"{name} {threshold} {count} {fast} {out}")
    flow.source(TestSource(Scores)).to(TestSink())
    return flow

def not_a_flow(x: int) -> int:
    return x
"""

FUNCTION = "from flows.graph import Flow\ndef f() -> Flow:\n    "


def _file(folder: Path, code: str) -> str:
    path = folder / "mine.py"
    path.write_text(code)
    return str(path)


def test_the_only_flow_of_a_file_needs_no_name(tmp_path: Path) -> None:
    declaration = load(_file(tmp_path, GOOD))
    assert declaration.name == "pressed"
    assert list(declaration.parameters) == ["threshold", "count", "name", "fast", "out"]
    assert declaration.flow().name == "pressed 0.5 2 False None"


def test_a_finished_flow_is_found_by_its_name(tmp_path: Path) -> None:
    code = GOOD + "\nmine = pressed()\n"
    assert isinstance(load(_file(tmp_path, code) + ":mine").flow(), Flow)
    with pytest.raises(InputError, match=r"several flows, choose one: .*:pressed, .*:mine"):
        load(_file(tmp_path, code))


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("def broken(:\n", r"mine\.py:1: invalid syntax"),
        ("\n1 / 0\n", r"mine\.py:2: ZeroDivisionError: division by zero"),
        ("import no_such_module\n", r"mine\.py:1: ModuleNotFoundError"),
        (
            "\nfrom operators import Zero; Zero().to(None)",
            r"mine\.py:2: .* 'to': write \(stream \| Zero\(\)\)\.to\(",
        ),
        ("from .module import x\n", r"mine\.py:1: .*relative import.*: write from module import name, "),
        ("x = '\0'\n", r"mine\.py: source code string cannot contain null bytes"),
        ("import a_module_that_divides\n", r"a_module_that_divides\.py:2: ZeroDivisionError"),
        ("x = 1\n", "has no flow"),
        (
            "from flows.graph import Flow\ndef f(x: int) -> Flow: ...",
            "flow 'f': parameter 'x' needs a default",
        ),
        (FUNCTION + "return 5", r"mine\.py: flow 'f' must return a Flow, but returned int$"),
        (FUNCTION + "import sys; sys.exit(3)", r"mine\.py:3: calls sys\.exit$"),
        (FUNCTION + "return undefined", r"mine\.py:3: NameError: name 'undefined' is not defined$"),
    ],
)
def test_an_error_in_a_file_or_its_function_is_one_line_with_its_location(
    tmp_path: Path, code: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "a_module_that_divides.py").write_text("\n1 / 0\n")
    with pytest.raises(InputError, match=message) as raised:
        load(_file(tmp_path, code)).flow()
    assert "\n" not in str(raised.value)


def test_a_missing_file_and_a_missing_flow_are_reported(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere: is neither a flow file nor a shipped flow \(demo, lift"):
        load("nowhere")
    with pytest.raises(InputError, match=r"nowhere\.py: there is no such file"):
        load("nowhere.py")
    with pytest.raises(InputError, match="is a folder: name the flow file in it"):
        load(str(tmp_path))
    with pytest.raises(InputError, match="has no flow 'other'; it has pressed"):
        load(_file(tmp_path, GOOD) + ":other")


def test_a_flow_imports_modules_of_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "own_part_of_a_flow.py").write_text("NAME = 'beside'\n")
    code = "from flows.graph import Flow\nfrom own_part_of_a_flow import NAME\n"
    code += "def f() -> Flow:\n    return Flow(NAME)\n"
    assert load(_file(tmp_path, code)).flow().name == "beside"


def test_a_helper_may_have_annotations_that_only_type_checkers_resolve(tmp_path: Path) -> None:
    code = "from __future__ import annotations\nfrom typing import TYPE_CHECKING\nif TYPE_CHECKING:\n"
    code += "    from decimal import Decimal\nfrom flows.graph import Flow\n"
    code += "def helper(x: Decimal) -> int: return 1\ndef f() -> Flow: return Flow('f')\n"
    assert load(_file(tmp_path, code)).name == "f"


def test_flow_files_of_one_name_are_several_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    folders = tmp_path / "a", tmp_path / "b"
    for folder in folders:
        folder.mkdir()
    flows = [load(_file(folder, GOOD + "\nclass Own: pass\n")) for folder in folders]
    for flow in flows:
        assert isinstance(flow.build, FunctionType)
        own = flow.build.__globals__["Own"]
        assert pickle.dumps(own)  # its module is found by its name


@pytest.mark.parametrize("clash", ["operators.py", "storage/sqlite.py"])
def test_a_module_named_like_a_package_of_slipflow_is_an_error(tmp_path: Path, clash: str) -> None:
    (tmp_path / clash).parent.mkdir(exist_ok=True)
    (tmp_path / clash).write_text("")
    name = Path(clash).parts[0]
    with pytest.raises(InputError, match=f"{name}: has the name of a package of slipflow.*rename {name}"):
        load(_file(tmp_path, GOOD))


def test_a_folder_of_data_named_like_a_package_is_no_clash(tmp_path: Path) -> None:
    (tmp_path / "storage").mkdir()
    assert load(_file(tmp_path, GOOD)).name
