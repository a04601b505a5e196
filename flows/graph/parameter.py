"""A parameter of a flow: what it takes, and how that is written on the command line."""

import types
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, Final, Union, get_args, get_origin

from flows.graph.quantity import KINDS, quantity, written
from operators.errors import ParameterError
from operators.ports import Json

_TRUTH: Final = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
_NAMES: Final = {bool: "yes or no", int: "a whole number", float: "a number", str: "text", Path: "a path"}


@dataclass(frozen=True)
class Parameter:
    """An argument of the function that declares a flow.

    >>> from flows.graph.quantity import Duration
    >>> delay = Parameter("delay", Duration, 70_000_000)
    >>> print(delay)
    delay=70ms  (a time with its unit: 500ms, 30s, 5min or 1h)
    >>> delay.value("record", "0.1s")
    100000000
    """

    name: str
    type: Any  # as annotated
    default: object

    def value(self, owner: str, text: str) -> object:
        """What a person wrote, as the type that is declared.

        A bare number is one of the SI unit; a time is never bare. Text is empty only where its default is.

        Args:
            owner: The flow, for the error.
            text: As it was written.

        Raises:
            ParameterError: if it is of another kind.
        """
        choices = self._choices()
        if type(None) in choices and text in ("", "none", "None"):
            return None
        for choice in choices:
            if (unit := _unit(choice)) is not None:
                return _measured(owner, self.name, text, unit)
            if choice is bool and text.lower() in _TRUTH:
                return _TRUTH[text.lower()]
            if choice in (str, Path) and not text and self.default != "":
                break  # as of a variable that is not set: a path would be this folder
            if choice in (int, float, str, Path):
                try:
                    return choice(text)
                except ValueError:
                    continue
        raise ParameterError(owner, self.name, text, self.takes)

    @property
    def unit(self) -> str | None:
        """The unit of its values, as ns; None: they have none."""
        return next((unit for choice in self._choices() if (unit := _unit(choice)) is not None), None)

    @property
    def takes(self) -> str:
        """What it takes, for a person."""
        return " or ".join(map(_named, self._choices()))

    def __str__(self) -> str:
        """What to write to set it to its default."""
        default = self.default
        if self.unit and isinstance(default, int | float) and isfinite(default):
            default = written(default, self.unit)
        return f"{self.name}={default}  ({self.takes})"

    def as_dict(self) -> dict[str, Json]:
        """The same for a program."""
        default = self.default
        if default is not None and not isinstance(default, bool | int | float | str):
            default = str(default)
        return {"default": default, "unit": self.unit, "takes": self.takes}

    def _choices(self) -> tuple[Any, ...]:
        union = get_origin(self.type) in (Union, types.UnionType)
        choices = get_args(self.type) if union else (self.type,)
        bare = get_origin(choices[0]) is Annotated and _unit(choices[0]) is None  # says nothing to us
        return (get_args(choices[0])[0], *choices[1:]) if bare else choices


def _unit(choice: Any) -> str | None:  # noqa: ANN401 - annotations are any type
    """The unit that an annotation names."""
    named = get_args(choice)[1:] if get_origin(choice) is Annotated else ()
    return next((each for each in named if isinstance(each, str) and each in KINDS), None)


def _named(choice: Any) -> str:  # noqa: ANN401 - the same
    if (unit := _unit(choice)) is not None:
        return f"{KINDS[unit].name} with its unit: {KINDS[unit].examples}"
    if choice is type(None):
        return "none"
    return _NAMES.get(choice, getattr(choice, "__name__", str(choice)))


def _measured(owner: str, name: str, text: str, unit: str) -> float:
    if unit != "ns" and isfinite(bare := _number(text)):  # a bare 70 would be 70 ns, and nobody means that
        return bare
    return quantity(owner, name, text, unit, signed=True)


def _number(text: str) -> float:
    """What a bare number is; infinite where there is none."""
    try:
        return float(text)
    except ValueError:
        return inf
