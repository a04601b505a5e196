"""What belongs to one job, on the storage that all machines of the cluster share; it goes with the job.

.. code-block:: text

    job.json               the flow, its parameters, where its datasets stand
    flow/<name>.py         the flow's file, as it was when the job began
    claims/<name>.jsonl    which rows are whose turn; whole when they appear
    staged/<session>/<turn>/<share>/<claim>.npz
    done/<session>.json    that a session is written, or why it is not
"""

from collections.abc import Iterable, Mapping
from contextlib import chdir, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from shutil import copyfile, rmtree
from threading import Lock
from typing import Any, Final, Self
from uuid import uuid4

from flows.graph import Flow
from flows.graph.loading import SHIPPED, Declaration, load
from flows.run.cluster.assembly import JOBS, assemble
from flows.run.cluster.work_units import Claim, Done
from operators.errors import EndpointError, InputError, os_error_reason
from operators.ports import Sink
from storage import files

_JOB: Final = "job.json"
_LOADING: Final = Lock()  # Flink runs several functions in one process


@dataclass(frozen=True)
class JobFolder:
    """The folder of one job."""

    path: Path

    @classmethod
    def create(cls, job: str, declaration: Declaration, settings: Mapping[str, str], flow: Flow) -> Self:
        """Make the folder of a new job, in the first of the flow's datasets.

        Args:
            job: Its name, a file name.
            declaration: Where the flow is from.
            settings: Its parameters, as text.
            flow: The flow.

        Raises:
            EndpointError: if it cannot be made.
        """
        places = {node.name: node.part.destination for node in flow.sinks() if isinstance(node.part, Sink)}
        path = Path(next(iter(places.values()))) / JOBS / job
        folder, target = cls(path), f"{declaration.file.stem}:{declaration.name}"
        try:
            for each in (folder.claims, folder.staged, path / "done", path / "flow"):
                each.mkdir(parents=True)
            if declaration.file.parent != SHIPPED:
                target = f"flow/{declaration.file.name}:{declaration.name}"
                copyfile(declaration.file, path / "flow" / declaration.file.name)
            files.put_json(
                path / _JOB,
                {
                    "job": job,
                    "target": target,
                    "settings": dict(settings),
                    "directory": str(Path.cwd()),
                    "places": places,
                },
            )
        except OSError as error:
            raise _unwritable(path, error) from error
        return folder

    @property
    def about(self) -> dict[str, Any]:
        """What job.json says.

        Raises:
            InputError: if it cannot be read: is the folder on storage that this machine shares?
        """
        return files.read_json(self.path / _JOB)

    @property
    def claims(self) -> Path:
        """Where the cluster looks for claims."""
        return self.path / "claims"

    @property
    def staged(self) -> Path:
        """Where workers put what they have worked out."""
        return self.path / "staged"

    def flow(self) -> Flow:
        """The flow; paths in its parameters hold as they did where the job was begun.

        Raises:
            SlipflowError: if it cannot be built.
        """
        about = self.about
        target, directory = about["target"], Path(about["directory"])
        if target.startswith("flow/"):
            target = str(self.path / target)
        with _LOADING, chdir(directory if directory.is_dir() else self.path):
            return _loaded(target).flow(about["settings"])

    def claim(self, name: str, claims: Iterable[Claim]) -> None:
        """Hand claims to the cluster, as a file of this name.

        Raises:
            EndpointError: if it cannot be written.
        """
        scratch = self.path / f"{name}.{uuid4().hex}"
        try:
            scratch.write_text("".join(f"{claim.line()}\n" for claim in claims))
            scratch.replace(self.claims / f"{name}.jsonl")
        except OSError as error:
            raise _unwritable(self.path, error) from error

    def finish(self, done: Done) -> None:
        """Write a session of which all is worked out, and note that; or note why it is not.

        Raises:
            EndpointError: if a dataset cannot be written to: then nothing is noted.
        """
        if self.error(done.session) == "":
            return
        error = done.error
        if not error:
            try:
                about = self.about
                assemble(self.flow(), about["places"], about["job"], self.staged / done.key, done)
            except InputError as failure:
                error = str(failure)
        try:
            note = {"session": done.session, "error": error}
            files.put_json(self.path / "done" / f"{done.session}.json", note)
        except OSError as failure:
            raise _unwritable(self.path, failure) from failure
        with suppress(OSError):
            rmtree(self.staged / done.session)

    def error(self, session: str) -> str | None:
        """Why a session could not be worked out; empty: it is written; None: it is not done yet.

        Raises:
            InputError: if what was noted is damaged.
        """
        path = self.path / "done" / f"{session}.json"
        return str(files.read_json(path)["error"]) if path.exists() else None

    def done(self) -> dict[str, str]:
        """The sessions that are done, each with its error, which is empty where there was none."""
        names = sorted(path.stem for path in (self.path / "done").glob("*.json"))
        return {name: self.error(name) or "" for name in names}

    def remove(self) -> None:
        """Remove the folder, and that of all jobs if it was the last."""
        places = [Path(place) / JOBS for place in self.about["places"].values()]
        for place in places:
            rmtree(place / self.path.name, ignore_errors=True)
            with suppress(OSError):
                place.rmdir()


@cache
def _loaded(target: str) -> Declaration:
    """Loaded once in a process: of a file that is loaded again, the operators are of other classes."""
    return load(target)


def _unwritable(path: Path, error: OSError) -> EndpointError:
    return EndpointError(str(path), f"cannot be written: {os_error_reason(error)}")
