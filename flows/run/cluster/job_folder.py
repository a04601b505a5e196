"""Folder of one job, on the storage that all machines of the cluster share; removed with the job.

.. code-block:: text

    job.json               the flow, its parameters and the folders of its datasets
    flow/<name>.py         the flow's file and the modules of its folder, as of the start of the job
    units/<name>.lines     work units; a file appears when it is complete
    <attempt>/             a session that is being written, see flows.run.cluster.assembly
    done/<session>.json    error of a session; empty if it was written
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import chdir, suppress
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from shutil import copyfile, rmtree
from threading import Lock
from typing import Any, Final, Self
from uuid import uuid4

from flows.graph import Flow
from flows.graph.loading import Declaration, load, loaded_modules
from flows.run.cluster.assembly import JOBS, assemble
from flows.run.cluster.work_units import UnitResult, WorkUnit
from operators.errors import EndpointError, InputError, os_error_reason
from operators.ports import Sink
from storage import files

_JOB: Final = "job.json"
_LOADING: Final = Lock()  # Flink runs several functions in one process


@dataclass(frozen=True)
class JobFolder:
    """Folder of one job."""

    path: Path

    @classmethod
    def create(cls, job: str, declaration: Declaration, settings: Mapping[str, str], flow: Flow) -> Self:
        """Create the folder of a new job in the first dataset of its flow.

        Args:
            job: Name of the job, a file name.
            declaration: Declaration of the flow.
            settings: Parameters of the flow, as text.
            flow: The flow.

        Raises:
            EndpointError: if the folder cannot be created.
        """
        datasets = {node.name: node.part.destination for node in flow.sinks() if isinstance(node.part, Sink)}
        path = Path(next(iter(datasets.values()))) / JOBS / job
        folder = cls(path)
        try:
            for each in (folder.units, path / "done", path / "flow"):
                each.mkdir(parents=True)
            copyfile(declaration.file, path / "flow" / declaration.file.name)
            for name, file in loaded_modules(declaration.file).items():
                (path / "flow" / name).parent.mkdir(parents=True, exist_ok=True)
                copyfile(file, path / "flow" / name)
            files.put_json(
                path / _JOB,
                {
                    "job": job,
                    "target": f"flow/{declaration.file.name}:{declaration.name}",
                    "settings": dict(settings),
                    "directory": str(Path.cwd()),
                    "datasets": datasets,
                },
            )
        except OSError as error:
            raise _write_error(path, error) from error
        return folder

    @property
    def about(self) -> dict[str, Any]:
        """Contents of job.json.

        Raises:
            InputError: if it cannot be read, for example because this machine does not share the storage.
        """
        return files.read_json(self.path / _JOB)

    @property
    def units(self) -> Path:
        """Folder that the cluster reads work units from."""
        return self.path / "units"

    def flow(self) -> Flow:
        """Build the flow; relative paths in its parameters refer to the directory where the job began.

        Raises:
            SlipflowError: if it cannot be built.
        """
        about = self.about
        directory = Path(about["directory"])
        with _LOADING, chdir(directory if directory.is_dir() else self.path):
            return _load_once(str(self.path / about["target"])).flow(about["settings"])

    def add_units(self, name: str, units: Iterable[WorkUnit]) -> None:
        """Send work units to the cluster, as a file with this name.

        Raises:
            EndpointError: if it cannot be written.
        """
        scratch = self.path / f"{name}.{uuid4().hex}"
        try:
            scratch.write_text("".join(f"{unit.to_line()}\n" for unit in units))
            scratch.replace(self.units / f"{name}.lines")
        except OSError as error:
            raise _write_error(self.path, error) from error

    def finish(self, last: UnitResult, shares: Sequence[Iterable[UnitResult]]) -> None:
        """Write a session whose units are all processed, or store the error of a failed one.

        Args:
            last: Result that completed the session or has an error.
            shares: All results of each share, in order; not read if there is an error.

        Raises:
            EndpointError: if a dataset cannot be written to; nothing is stored then.
        """
        session, error = last.unit.session, last.error
        if self.done().get(session) == "":
            return
        if not error:
            try:
                about = self.about
                slices = [chain.from_iterable(result.slices for result in share) for share in shares]
                assemble(self.flow(), about["datasets"], about["job"], last, slices)
            except InputError as failure:
                error = str(failure)
        try:
            note = {"session": session, "error": error}
            files.put_json(self.path / "done" / f"{session}.json", note)
        except OSError as failure:
            raise _write_error(self.path, failure) from failure

    def done(self) -> dict[str, str]:
        """Return the finished sessions with their errors; empty: no error.

        Raises:
            InputError: if a file is damaged.
        """
        names = sorted((self.path / "done").glob("*.json"))
        return {path.stem: str(files.read_json(path)["error"]) for path in names}

    def remove(self) -> None:
        """Remove the folder, and the folder of all jobs if it is empty then."""
        for jobs in [Path(dataset) / JOBS for dataset in self.about["datasets"].values()]:
            rmtree(jobs / self.path.name, ignore_errors=True)
            with suppress(OSError):
                jobs.rmdir()


@cache
def _load_once(target: str) -> Declaration:
    """Load a flow file once per process: a second load would create different classes."""
    return load(target)


def _write_error(path: Path, error: OSError) -> EndpointError:
    return EndpointError(str(path), f"cannot be written: {os_error_reason(error)}")
