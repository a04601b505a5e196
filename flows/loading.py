"""Finding the flow in a Python file, and setting the parameters that it declares.

A flow file holds functions that return a `Flow`; their arguments, which all have defaults, are the flow's
parameters. A file may also hold a finished `Flow`, which then has none. A flow file is code: loading it
runs it, so load only files that you trust.
"""

import importlib.util
import inspect
import sys
import traceback
import types
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

from flows.graph import Flow
from operators.errors import InputError, ParameterError, SlipflowError

READY_MADE = Path(__file__).parent


@dataclass(frozen=True)
class Declaration:
    """A flow that a file declares, not built yet."""

    name: str
    file: Path
    build: Callable[..., Flow]
    parameters: Mapping[str, tuple[Any, object]]  # name: (type, default)

    def flow(self, settings: Mapping[str, str] | None = None) -> Flow:
        """Build the flow, its parameters set from text.

        Raises:
            ParameterError: if a setting names no parameter or its value is of another type.
            InputError: if the file's own code fails.
        """
        values: dict[str, object] = {}
        for name, text in (settings or {}).items():
            if name not in self.parameters:
                known = ", ".join(self.parameters) or "none"
                raise ParameterError(self.name, name, text, f"the name of one of its parameters ({known})")
            values[name] = _value(self.name, name, text, self.parameters[name][0])
        with _errors_of(self.file):
            return self.build(**values)


def load(target: str) -> Declaration:
    """The flow that ``FILE[:NAME]`` names; FILE may be the bare name of a ready-made flow, as ``live``.

    Raises:
        InputError: if the file is missing, is no Python, or does not hold that flow.
    """
    path, _, name = target.partition(":")
    file = Path(path)
    if not file.suffix and not file.exists() and (READY_MADE / f"{path}.py").exists():
        file = READY_MADE / f"{path}.py"
    if not file.is_file():
        raise InputError(
            path, "no such flow file, and no ready-made flow: those are live, record, relabel and lift"
        )
    found = _declared_in(_imported(file), file)
    if name and name not in found:
        raise InputError(path, f"holds no flow {name!r}; it holds {', '.join(found) or 'none'}")
    if not name and len(found) != 1:
        if not found:
            raise InputError(path, "holds no flow: a Flow, or a function annotated to return one")
        raise InputError(path, f"holds several flows, choose one: {', '.join(f'{path}:{n}' for n in found)}")
    return found[name or next(iter(found))]


def _imported(file: Path) -> types.ModuleType:
    spec = importlib.util.spec_from_file_location(f"flow_file_{file.stem}", file)
    if spec is None or spec.loader is None:
        raise InputError(str(file), "is not a Python file: its name must end in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses and get_type_hints look their module up
    with _errors_of(file):
        spec.loader.exec_module(module)
    return module


def _declared_in(module: types.ModuleType, file: Path) -> dict[str, Declaration]:
    found: dict[str, Declaration] = {}
    for name, value in vars(module).items():
        if isinstance(value, Flow):
            found[name] = Declaration(name, file, partial(_same, value), {})
        elif inspect.isfunction(value) and value.__module__ == module.__name__:
            with _errors_of(file):
                hints = get_type_hints(value)
            if hints.get("return") is Flow:
                arguments = inspect.signature(value).parameters
                bare = [a for a, p in arguments.items() if p.default is inspect.Parameter.empty]
                if bare:
                    raise InputError(str(file), f"flow {name!r}: parameter {bare[0]!r} needs a default")
                declared = {a: (hints.get(a, str), p.default) for a, p in arguments.items()}
                found[name] = Declaration(name, file, value, declared)
    return found


def _same(flow: Flow) -> Flow:
    return flow


@contextmanager
def _errors_of(file: Path) -> Generator[None]:
    """Tell an error of a flow file in one line that names the place in it."""
    try:
        yield
    except SlipflowError:
        raise
    except SyntaxError as error:
        raise InputError(f"{error.filename or file}:{error.lineno}", error.msg) from error
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if Path(frame.filename).resolve() == file.resolve()]
        where = f"{file}:{lines[-1]}" if lines else str(file)
        raise InputError(where, f"{type(error).__name__}: {error}") from error


def _value(owner: str, name: str, text: str, kind: Any) -> object:  # noqa: ANN401 - annotations are any type
    choices = get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)
    if type(None) in choices and text in ("", "none", "None"):
        return None
    for choice in choices:
        if choice is bool and text.lower() in _TRUTH:
            return _TRUTH[text.lower()]
        if choice in (int, float, str, Path):
            try:
                return choice(text)
            except ValueError:
                continue
    names = " or ".join(getattr(choice, "__name__", str(choice)) for choice in choices)
    raise ParameterError(owner, name, text, f"of type {names}")


_TRUTH = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
