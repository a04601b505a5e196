"""Loading of a flow from a Python file.

A flow file holds functions that return a `Flow`. Their arguments, which all need defaults, are the flow's
parameters. A file may also hold a `Flow` object, which has no parameters. Loading a flow file executes it, so
load only files that you trust.
"""

import hashlib
import importlib.util
import inspect
import re
import sys
import traceback
import types
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, get_type_hints

from flows.graph.flow import Flow
from flows.graph.parameter import Parameter
from operators.errors import InputError, SlipflowError
from operators.operator import AnyOperator

SHIPPED = Path(__file__).parents[1]  # folder of the shipped flows
_DESCRIBED: Final = re.compile(r"^ {4}(\w+): (.+)$", re.MULTILINE)  # argument in a docstring
_PACKAGES: Final = tuple(
    SHIPPED.parent / name for name in ("connectors", "flows", "operators", "storage")
)  # of slipflow


@dataclass(frozen=True)
class Declaration:
    """Flow that a file declares, before it is built."""

    name: str
    file: Path
    build: Callable[..., object]  # must return a Flow
    parameters: Mapping[str, Parameter]  # by name

    def flow(self, settings: Mapping[str, str] | None = None) -> Flow:
        """Build the flow with parameters from text.

        Raises:
            ParameterError: if a setting does not have the type of its parameter.
            InputError: if a setting names no parameter, the code of the file fails, or it returns no `Flow`.
        """
        values: dict[str, object] = {}
        for name, text in (settings or {}).items():
            if name not in self.parameters:
                has = ", ".join(self.parameters) or "none"
                raise InputError(self.name, f"has no parameter {name!r}; it has {has}")
            values[name] = self.parameters[name].value(self.name, text)
        with _errors_of(self.file):
            flow = self.build(**values)
        if not isinstance(flow, Flow):
            reason = f"flow {self.name!r} must return a Flow, but returned {type(flow).__name__}"
            raise InputError(str(self.file), reason)
        if files := flow_files(self.file):
            flow.code = hashlib.sha256(repr(files).encode()).hexdigest()
        return flow


def shipped_flows() -> list[str]:
    """Return the names of the shipped flows.

    >>> shipped_flows()
    ['demo', 'lift', 'live', 'record', 'relabel']
    """
    return sorted(file.stem for file in SHIPPED.glob("[!_]*.py"))


def load(target: str) -> Declaration:
    """Load the flow ``FILE[:NAME]``; FILE may be the name of a shipped flow, such as ``live``.

    Raises:
        InputError: if the file is missing, is not Python, or does not hold that flow, or a module next to it
            has the name of one of slipflow's packages.
    """
    path, _, name = target.partition(":")
    file = Path(path)
    if not file.suffix and not file.is_file() and (SHIPPED / f"{path}.py").exists():
        file = SHIPPED / f"{path}.py"
    if file.is_dir():
        raise InputError(path, "is a folder: name the flow file in it, as FILE.py or FILE.py:FLOW")
    if not file.is_file():
        other = f"is neither a flow file nor a shipped flow ({', '.join(shipped_flows())})"
        raise InputError(path, "there is no such file" if file.suffix == ".py" else other)
    found = _declared_in(_imported(file), file)
    if name and name not in found:
        raise InputError(path, f"has no flow {name!r}; it has {', '.join(found) or 'none'}")
    if not name and len(found) != 1:
        if not found:
            raise InputError(path, "has no flow: add a Flow, or a function annotated with `-> Flow`")
        raise InputError(path, f"has several flows, choose one: {', '.join(f'{path}:{n}' for n in found)}")
    return found[name or next(iter(found))]


def flow_files(file: Path) -> tuple[tuple[str, bytes], ...]:
    """Return a flow file and the loaded modules next to it: paths in its folder, contents; () if shipped."""
    folder = file.resolve().parent
    if folder == SHIPPED:
        return ()
    found = {Path(file.name): file}
    for name, module in [*sys.modules.items()]:
        path = Path(getattr(module, "__file__", None) or "").resolve()
        module_path = Path(*name.split("."))
        for relative in (module_path.with_suffix(".py"), module_path / "__init__.py"):
            if path == folder / relative and folder / relative.parts[0] not in _PACKAGES:
                found[relative] = path
    return tuple((name.as_posix(), path.read_bytes()) for name, path in sorted(found.items()))


def _imported(file: Path) -> types.ModuleType:
    """Execute a flow file, which can import the modules of its folder."""
    folder = file.resolve().parent
    _refuse_clashes(folder)
    if folder != SHIPPED and str(folder) not in sys.path:
        sys.path.append(str(folder))  # last: its modules replace no installed ones
    spec = importlib.util.spec_from_file_location(_module_name(file), file)
    if spec is None or spec.loader is None:
        raise InputError(str(file), "is not a Python file: its name must end in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses and get_type_hints look up their module
    with _errors_of(file):
        spec.loader.exec_module(module)
    return module


def _module_name(file: Path) -> str:
    """Return a name that no other loaded flow file has; for the first one, it is the same in each process."""
    name = f"flow_file_{file.stem}"
    while (loaded := sys.modules.get(name)) and Path(loaded.__file__ or "").resolve() != file.resolve():
        name += "_"
    return name


def _refuse_clashes(folder: Path) -> None:
    """Raise an error if a module in the folder has the name of one of slipflow's packages."""
    for own in _PACKAGES:
        found = folder / own.name if any((folder / own.name).glob("*.py")) else folder / f"{own.name}.py"
        if found.exists() and found != own:
            reason = f"has the name of a package of slipflow, so a flow cannot import it: rename {found.name}"
            raise InputError(str(found), reason)


def _declared_in(module: types.ModuleType, file: Path) -> dict[str, Declaration]:
    found: dict[str, Declaration] = {}
    for name, value in vars(module).items():
        if isinstance(value, Flow):
            found[name] = Declaration(name, file, lambda flow=value: flow, {})
        elif inspect.isfunction(value) and value.__module__ == module.__name__:
            if "Flow" not in str(value.__annotations__.get("return")):  # a helper, of whatever types
                continue
            with _errors_of(file):
                hints = get_type_hints(value, include_extras=True)
            if hints.get("return") is Flow:
                arguments = inspect.signature(value).parameters
                bare = [a for a, p in arguments.items() if p.default is inspect.Parameter.empty]
                if bare:
                    raise InputError(str(file), f"flow {name!r}: parameter {bare[0]!r} needs a default")
                about = dict(_DESCRIBED.findall(inspect.getdoc(value) or ""))
                declared = {
                    a: Parameter(a, hints.get(a, str), p.default, about.get(a, ""))
                    for a, p in arguments.items()
                }
                found[name] = Declaration(name, file, value, declared)
    return found


@contextmanager
def _errors_of(file: Path) -> Generator[None]:
    """Convert an error of a flow file to one line with file and line number."""
    try:
        yield
    except SlipflowError:
        raise
    except SyntaxError as error:
        line = "" if error.lineno is None else f":{error.lineno}"
        raise InputError(f"{error.filename or file}{line}", error.msg) from error
    except (Exception, SystemExit) as error:
        frames, folder = traceback.extract_tb(error.__traceback__), file.resolve().parent
        inside = [each for each in frames if Path(each.filename).resolve().parent == folder]
        where = (
            f"{file.with_name(Path(inside[-1].filename).name)}:{inside[-1].lineno}" if inside else str(file)
        )
        reason = "calls sys.exit" if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}"
        raise InputError(where, reason + _hint(error)) from error


def _hint(error: BaseException) -> str:
    """Return what to write instead of ``stream | Debounce().to(sink)`` or ``from .module import name``."""
    if isinstance(error, ImportError) and "relative import" in str(error):
        return ": write from module import name, without the dot"
    if isinstance(error, AttributeError) and error.name == "to" and isinstance(error.obj, AnyOperator):
        return f": write (stream | {type(error.obj).__name__}()).to(...)"
    return ""
