import subprocess
import sys
from pathlib import Path
from shutil import rmtree

import pytest

from flows.graph.compiled_flow import CompiledFlow
from flows.graph.loading import load
from flows.run.cluster.job_folder import JobFolder
from flows.run.cluster.work_units import UnitResult, WorkUnit
from operators import EndpointError, InputError

FLOW = """
from dataclasses import dataclass
from flows.graph import Flow
from flows.graph.testing import TestSource
from operators import Debounce, Operator, Score, Touch, Zero, Zeroed
from storage import Dataset, load_detector

@dataclass
class Own(Operator[Zeroed, Zeroed]):
    def process(self, batch: Zeroed) -> Zeroed:
        return batch

def slips(out: str = "out") -> Flow:
    flow = Flow("slips")
    scores = flow.source(TestSource(Touch)) | Zero() | Own() | Score(load_detector("psd"))
    (scores | Debounce()).to(Dataset(out))
    return flow
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "slips_flow.py"
    path.write_text(FLOW)
    return path


def created(file: Path, out: str) -> JobFolder:
    declaration = load(str(file))
    return JobFolder.create("job", declaration, {"out": out}, declaration.flow({"out": out}))


def test_the_flow_file_is_copied_when_the_job_begins(file: Path, tmp_path: Path) -> None:
    folder = created(file, str(tmp_path / "out"))
    file.write_text("raise RuntimeError")
    assert str(folder.flow()).startswith("flow slips\n")


def test_modules_of_the_flow_s_folder_are_imported_in_another_process_and_place(tmp_path: Path) -> None:
    folder = tmp_path / "own"
    (folder / "own_parts").mkdir(parents=True)
    (folder / "own_names.py").write_text("NAME = 'sibling'")
    (folder / "own_parts" / "__init__.py").touch()
    (folder / "own_parts" / "levels.py").write_text("LEVEL = 0.25")
    (folder / "unrelated.py").write_text("raise RuntimeError")
    imports = "from own_names import NAME\nfrom own_parts.levels import LEVEL\n"
    (folder / "job_flow.py").write_text(
        imports + FLOW.replace('"slips"', "NAME").replace("Debounce()", "Debounce(LEVEL)")
    )
    job = created(folder / "job_flow.py", str(tmp_path / "out"))
    rmtree(folder)
    code = "from flows.run.cluster.job_folder import *; print(JobFolder(Path(sys.argv[1])).flow())"
    command = [sys.executable, "-c", f"import sys; {code}", str(job.path)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert printed.startswith("flow sibling\n")
    assert "0.25" in printed
    assert not (job.path / "flow" / "unrelated.py").exists()


def test_snapshots_are_valid_for_all_functions_of_one_process(file: Path, tmp_path: Path) -> None:
    folder = created(file, str(tmp_path / "out"))
    first = CompiledFlow(folder.flow())
    folder.flow()
    CompiledFlow(folder.flow()).restore(first.snapshot())


def test_relative_paths_refer_to_the_directory_where_the_job_began(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = created(file, "out")
    monkeypatch.chdir("/")
    assert str(tmp_path / "out") in str(folder.flow())
    assert folder.path == tmp_path / "out" / ".jobs" / "job"


def test_a_file_of_units_appears_when_it_is_complete(file: Path, tmp_path: Path) -> None:
    folder = created(file, str(tmp_path / "out"))
    unit = WorkUnit("one", "/one", 0, 0, 0, (0,), 0, {}, ())
    folder.add_units("first", [unit, unit])
    assert [path.name for path in folder.units.iterdir()] == ["first.lines"]
    assert (folder.units / "first.lines").read_text() == 2 * f"{unit.to_line()}\n"


def test_a_failure_is_noted(file: Path, tmp_path: Path) -> None:
    folder = created(file, str(tmp_path / "out"))
    assert folder.done() == {}
    unit = WorkUnit("one", "/one", 0, 0, 0, (0,), 0, {}, ())
    folder.finish(UnitResult(unit, error="is damaged"), [])
    assert folder.done() == {"one": "is damaged"}


def test_a_removed_job_leaves_no_files(file: Path, tmp_path: Path) -> None:
    created(file, str(tmp_path / "out")).remove()
    assert list((tmp_path / "out").iterdir()) == []


def test_a_running_job_of_the_same_name_is_an_error(file: Path, tmp_path: Path) -> None:
    created(file, str(tmp_path / "out"))
    with pytest.raises(EndpointError, match="cannot be written: File exists"):
        created(file, str(tmp_path / "out"))


def test_a_folder_that_this_machine_does_not_share_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"job\.json: cannot be read"):
        JobFolder(tmp_path / "elsewhere").flow()
