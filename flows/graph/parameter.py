"""Parameters of a flow, and their text form on the command line."""

import types
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

from flows.graph.quantity import KINDS, format_quantity, parse_quantity
from operators.errors import ParameterError

_BOOLEANS: Final = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
_NAMES: Final = {bool: "yes or no", int: "a whole number", float: "a number", str: "text", Path: "a path"}


@dataclass(frozen=True)
class Parameter:
    """Argument of a function that declares a flow.

    >>> from flows.graph.quantity import Duration
    >>> delay = Parameter("delay", Duration, 70_000_000)
    >>> print(delay)
    delay=70ms  (a time with its unit: 500ms, 30s, 1h or 30d)
    >>> delay.value("record", "0.1s")
    100000000
    """

    name: str
    type: Any  # as annotated
    default: object
    about: str = ""  # description in the docstring of the function

    def value(self, owner: str, text: str) -> object:
        """Parse text as the annotated type.

        Numbers without a unit are in SI units; times and rates always need a unit. Empty text is valid
        only if it is the default. `owner` is the flow, for the error.

        Raises:
            ParameterError: if the text does not have the annotated type.
        """
        choices = self._choices()
        if type(None) in choices and text in ("", "none", "None"):
            return None
        for choice in choices:
            if (unit := _unit(choice)) is not None:
                return _parse_measured(owner, self.name, text, unit)
            if choice is bool and text.lower() in _BOOLEANS:
                return _BOOLEANS[text.lower()]
            if get_origin(choice) is Literal and text in map(str, get_args(choice)):
                return next(each for each in get_args(choice) if str(each) == text)
            # probably an unset shell variable; an empty path would be the current folder
            if choice in (str, Path) and not text and self.default != "":
                raise ParameterError(owner, self.name, text, "non-empty text")
            if choice in (int, float, str, Path):
                try:
                    return choice(text)
                except ValueError:
                    continue
        raise ParameterError(owner, self.name, text, self.takes)

    @property
    def takes(self) -> str:
        """Description of the accepted text."""
        return " or ".join(map(_description, self._choices()))

    def __str__(self) -> str:
        """Return the setting with its default and the accepted text."""
        default, units = self.default, list(filter(None, map(_unit, self._choices())))
        if units and isinstance(default, int | float) and isfinite(default):
            default = format_quantity(default, units[0])
        return f"{self.name}={default}  ({self.takes})"

    def _choices(self) -> tuple[Any, ...]:
        union = get_origin(self.type) in (Union, types.UnionType)
        return get_args(self.type) if union else (self.type,)


def _unit(choice: Any) -> str | None:
    """Return the unit in an annotation, or None."""
    named = get_args(choice)[1:] if get_origin(choice) is Annotated else ()
    return next((each for each in named if isinstance(each, str) and each in KINDS), None)


def _description(choice: Any) -> str:
    if (unit := _unit(choice)) is not None:
        return f"{KINDS[unit].name} with its unit: {KINDS[unit].examples}"
    if choice is type(None):
        return "none"
    if get_origin(choice) is Literal:
        return " or ".join(map(str, get_args(choice)))
    return _NAMES.get(choice, getattr(choice, "__name__", str(choice)))


def _parse_measured(owner: str, name: str, text: str, unit: str) -> float:
    with suppress(ValueError):
        if not unit.endswith("ns") and isfinite(bare := float(text)):  # 70 ns is never intended
            return bare
    return parse_quantity(owner, name, text, unit, signed=True)
