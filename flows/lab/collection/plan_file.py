"""Collection plans as TOML files; `plans/` holds those that ship with the package."""

from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from difflib import get_close_matches
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from flows.graph.quantity import parse_quantity
from flows.lab.collection.stroke_plan import CollectionPlan
from operators.errors import InputError, ParameterError
from storage.toml_text import parse_toml, read_text

T = TypeVar("T")

SHIPPED: Final = {path.stem: path for path in sorted((Path(__file__).parent / "plans").glob("*.toml"))}
_TYPES: Final = {bool: "true or false", int: "a whole number", float: "a number", str: "text in quotes"}


def plan_text(plan: str) -> tuple[Path, str]:
    """Return the path and the text of a plan: the name of a shipped one, or a TOML file.

    Raises:
        ParameterError: if there is no shipped plan of that name.
        InputError: if the file cannot be read.
    """
    path = SHIPPED.get(plan) or Path(plan)
    if not (path.suffix == ".toml" or path.is_file()):
        raise ParameterError("collect", "plan", plan, f"one of {', '.join(SHIPPED)}, or a .toml file")
    return path, read_text(path)


def load_plan(plan: str) -> CollectionPlan:
    """Return a plan: the name of a shipped one, or a TOML file, whose name is that of the plan by default.

    >>> load_plan("tiny").speeds
    (0.05,)

    Raises:
        ParameterError: if there is no shipped plan of that name, or a key has an invalid value.
        InputError: if the file cannot be read, is not TOML, or has an unknown key.
    """
    path, text = plan_text(plan)
    table = parse_toml(text, str(path))
    return _Reader(str(path)).table(CollectionPlan, {"name": path.stem, **table}, "")


class _Reader:
    """Converter of TOML values into dataclasses, by the annotations of their fields."""

    def __init__(self, file: str) -> None:
        self._file = file

    def table(self, kind: type[T], table: Mapping[str, Any], section: str) -> T:
        """Return a dataclass of the values of a table; `section` is its dotted name, empty for the file."""
        kinds = get_type_hints(kind, include_extras=True)
        for key in table:
            if key not in kinds:
                close = get_close_matches(key, kinds, 1)
                known = f"did you mean {close[0]!r}?" if close else f"known keys: {', '.join(kinds)}"
                raise InputError(self._file, f"unknown key {_dotted(section, key)}; {known}")
        values = {key: self._value(kinds[key], value, _dotted(section, key)) for key, value in table.items()}
        try:
            return kind(**values)
        except ParameterError as error:
            raise self._error(_dotted(section, error.name), error.value, error.must_be) from None

    def _value(self, kind: object, value: object, key: str) -> object:
        """Return a value of the annotated type `kind`."""
        origin, arguments = get_origin(kind), get_args(kind)
        if origin in (Union, UnionType):  # TOML has no null: the type that is not None
            return self._value(next(each for each in arguments if each is not NoneType), value, key)
        if origin is Annotated:
            return self._quantity(value, arguments[1], key)
        if origin is tuple:
            return tuple(self._items(arguments, value, key))
        if origin is Literal:  # checked by the dataclass
            return value
        if is_dataclass(kind):
            if not isinstance(value, dict):
                raise self._error(key, value, f"a table, [{key}]")
            return self.table(cast("type[Any]", kind), value, key)
        if type(value) is int and not -(2**63) <= value < 2**63:
            raise self._error(key, "too large", "a number of at most 64 bits")
        found = float(value) if kind is float and type(value) is int else value
        if type(found) is not kind:
            raise self._error(key, value, _TYPES[cast("type", kind)])
        return found

    def _items(self, kinds: tuple[object, ...], value: object, key: str) -> Iterator[object]:
        any_length = kinds[-1] is Ellipsis
        if not isinstance(value, list) or not (any_length or len(value) == len(kinds)):
            raise self._error(key, value, "a list" if any_length else f"a list of {len(kinds)} values")
        for number, item in enumerate(cast("list[object]", value)):
            yield self._value(kinds[0 if any_length else number], item, f"{key}[{number}]")

    def _quantity(self, value: object, unit: str, key: str) -> float:
        if not isinstance(value, str):
            raise self._error(key, value, 'text with a unit, such as "1.5mm", "0.4s", "50mm/s" or "2N"')
        if unit == "s":
            return parse_quantity(self._file, key, value, "ns") / 1e9
        return parse_quantity(self._file, key, value, unit)

    def _error(self, key: str, value: object, must_be: str) -> ParameterError:
        return ParameterError(self._file, key, value, must_be)


def _dotted(section: str, key: str) -> str:
    return f"{section}.{key}" if section else key
