"""Checks of parameter values."""

from collections.abc import Iterable
from numbers import Integral, Real
from typing import cast

from operators.errors import ParameterError

_SHORTEST = 1_000  # ns; a shorter time lacks its unit


def check_above(owner: str, name: str, value: float, low: float, unit: str = "") -> None:
    """Require `value` > `low`; NaN and a text fail.

    Raises:
        ParameterError: if it is not.
    """
    if not (isinstance(cast("object", value), Real) and value > low):
        raise ParameterError(owner, name, value, f"above {_number(low)} {unit}".rstrip())
    if unit == "ns":
        check_ns(owner, name, value)


def check_at_least(owner: str, name: str, value: float, least: float, unit: str = "") -> None:
    """Require `value` >= `least`; NaN and a text fail.

    >>> check_at_least("Label", "delay", -1, 0, "ns")
    Traceback (most recent call last):
    operators.errors.ParameterError: Label: delay is -1, must be at least 0 ns

    Raises:
        ParameterError: if it is not.
    """
    if not (isinstance(cast("object", value), Real) and value >= least):
        raise ParameterError(owner, name, value, f"at least {_number(least)} {unit}".rstrip())
    if unit == "ns":
        check_ns(owner, name, value)


def check_whole(owner: str, name: str, value: int, least: int, unit: str = "") -> None:
    """Require a whole number of at least `least`.

    Raises:
        ParameterError: if it is not.
    """
    if not isinstance(cast("object", value), Integral):
        raise ParameterError(owner, name, value, f"a whole number, at least {least} {unit}".rstrip())
    check_at_least(owner, name, value, least, unit)


def check_ns(owner: str, name: str, value: float) -> None:
    """Require whole ns, 0 or at least 1 us: other values lack their unit.

    >>> check_ns("Align", "within", 0.02)
    Traceback (most recent call last):
    operators.errors.ParameterError: Align: within is 0.02, must be in whole ns: for 20 ms write 20 * ms

    Raises:
        ParameterError: if it is not.
    """
    if not isinstance(cast("object", value), Integral) or 0 < abs(value) < _SHORTEST:
        raise ParameterError(owner, name, value, "in whole ns: for 20 ms write 20 * ms")


def check_between(owner: str, name: str, value: float, low: float, high: float, *, unit: str = "") -> None:
    """Require `low` <= `value` <= `high`; NaN and a text fail.

    >>> check_between("Debounce", "threshold", 1.5, 0, 1)
    Traceback (most recent call last):
    operators.errors.ParameterError: Debounce: threshold is 1.5, must be from 0 to 1

    Raises:
        ParameterError: if it is not.
    """
    if not (isinstance(cast("object", value), Real) and low <= value <= high):
        raise ParameterError(owner, name, value, f"from {_number(low)} to {_number(high)} {unit}".rstrip())


def check_choice(owner: str, name: str, value: object, choices: Iterable[object]) -> None:
    """Require that `value` is one of `choices`.

    >>> check_choice("simulate", "plan", "huge", ["paper", "tiny"])
    Traceback (most recent call last):
    operators.errors.ParameterError: simulate: plan is 'huge', must be one of paper, tiny

    Raises:
        ParameterError: if it is not.
    """
    known = list(choices)
    if value not in known:
        raise ParameterError(owner, name, value, f"one of {', '.join(map(str, known))}")


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"  # whole ns in full
