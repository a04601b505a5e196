"""The commands `slipflow evaluate`, `train` and `onnx` as processes."""

import json
import sys
from pathlib import Path

import pytest

from storage.models import shipped
from tests.command import captured, succeed


def test_evaluate_writes_page_and_tables(tiny: Path, tmp_path: Path) -> None:
    model = str(shipped("tcn"))
    options = ("--method", "psd", "--method", model)
    done = succeed("evaluate", str(tiny), *options, cwd=tmp_path)
    assert "judged on tiny, split: test: 2 recordings, 0.4 minutes after the warm-up\n" in done.stderr
    found = json.loads((tmp_path / "evaluation" / "evaluation.json").read_text())
    rows = found["sections"]["samples"]["tables"][0]["rows"]
    assert {row["method"] for row in rows} == {"psd", model}
    assert all(50 < row["accuracy %"] < 100 for row in rows)
    names = {path.name for path in (tmp_path / "evaluation").iterdir()}
    assert names == {"evaluation.html", "evaluation.json", "evaluation.md"}
    markdown = (tmp_path / "evaluation" / "evaluation.md").read_text()
    assert markdown.endswith(f"    slipflow evaluate {tiny} --method psd --method {model}\n")
    assert "| rotation" in markdown


HIDING = """
import sys
from importlib.machinery import PathFinder

class Hiding(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in {hidden} else super().find_spec(name, path, target)

sys.meta_path[sys.meta_path.index(PathFinder)] = Hiding
from flows.cli.main import main
main()
"""


@pytest.mark.parametrize(
    ("arguments", "hidden", "error"),
    [
        (["evaluate", "DATA", "--method", "tcn", "--method", "logistic", "--jobs", "1"],
         {"torch", "sklearn"},
         "not evaluated: logistic: needs scikit-learn: in the clone, pip install -e '.[baselines]'"),
        (["train", "DATA", "--filters", "2", "--steps", "1"], {"sklearn"}, ""),
    ],
)  # fmt: skip
def test_a_command_needs_only_the_packages_that_it_uses(
    tiny: Path, tmp_path: Path, arguments: list[str], hidden: set[str], error: str
) -> None:
    code = HIDING.replace("{hidden}", repr(hidden))
    given = [str(tiny) if each == "DATA" else each for each in arguments]
    done = captured(sys.executable, "-c", code, *given, cwd=tmp_path)
    assert error in done.stderr
    left_out = error.startswith("not evaluated")
    assert (done.returncode == 0) == (not error or left_out), done.stderr
