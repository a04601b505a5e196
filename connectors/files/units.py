"""Units in column names. Case counts where it carries meaning: mPa is not MPa, and T is not t."""

import re
from typing import Final

from connectors.files.column_map import COUNTS, SPEED, TIME, UNITS, VELOCITY

_OTHER_NAMES: Final = {  # in lower case
    name: unit
    for unit, names in {
        "s": "sec secs second seconds sek sekunden",
        "ms": "msec millis millisecond milliseconds",
        "us": "usec micros microsecond microseconds",
        "ns": "nsec nanos nanosecond nanoseconds",
        "min": "minute minutes",
        "h": "hour hours",
        "d": "day days",
        "count": "counts raw lsb digit digits adc a.u. -",
        "N": "newton",
        "V": "volt volts",
        "ohm": "\u03c9",
        "kohm": "k\u03c9",
    }.items()
    for name in names.split()
}
_TEMPERATURE: Final = re.compile(r"°.*|deg(rees)? ?[ckf]|celsius|kelvin|temp.*|[ckt]", re.IGNORECASE)
_BRACKETS: Final = re.compile(r"(.+?)[ _]*[\[({<]\s*([^\])}>]*?)\s*[\])}>]")
_ENDING: Final = re.compile(r"(.+?)(?:[ _]+(?:in )?|\s*/\s*)([^\d\s_/\[\]]+(?:/s)?)")


def unit_in(text: str, quantities: tuple[str, ...] = (TIME, COUNTS, SPEED, VELOCITY)) -> str:
    r"""Return the unit that a text is; empty if it is none of the quantities.

    >>> unit_in("KPA"), unit_in("mPa"), unit_in("MPA"), unit_in("\u00b5s"), unit_in("seconds")
    ('kPa', 'mPa', '', 'us', 's')
    """
    text = text.strip().replace("\u00b5", "u").replace("\u03bc", "u")
    known = dict.fromkeys(unit for quantity in quantities for unit in UNITS.get(quantity, ()))
    if text in known:
        return text
    other = _OTHER_NAMES.get(text.lower(), "")
    folded = [unit for unit in known if unit.casefold() == text.casefold()]
    if other not in known and len(folded) == 1 and _same_prefix(folded[0], text):
        return folded[0]
    return other if other in known else ""


def split_unit(quantity: str, name: str) -> tuple[str, str]:
    """Split the unit off a column name; an empty unit: it has none.

    An unknown unit of cells in brackets is kept as it is. After an underscore or a blank, one letter is a
    unit of time only.

    >>> split_unit("time", "t_ms"), split_unit("counts", "cell 1 [kPa]"), split_unit("counts", "b0_T")
    (('t', 'ms'), ('cell 1', 'kPa'), ('b0_T', ''))
    """
    if (match := _BRACKETS.fullmatch(name)) and not match[2].isdecimal():
        unit = unit_in(match[2], (quantity,))
        if unit or (quantity == COUNTS and match[2]):
            return match[1].strip(), unit or match[2]
        return name.strip(), ""
    match = _ENDING.fullmatch(name)
    if (
        match
        and (unit := unit_in(match[2], (quantity,)))
        and (len(unit) > 1 or quantity == TIME or "/" in name)
    ):
        return match[1].strip(), unit
    return name.strip(), ""


def is_temperature(text: str) -> bool:
    """Return True for a unit, or the ending of a name, of a temperature, such as ``degC`` or ``T``."""
    return bool(_TEMPERATURE.fullmatch(text))


def _same_prefix(unit: str, text: str) -> bool:
    """Return True if case does not change the meaning: m is not M, and one letter stands for itself."""
    return unit in UNITS[TIME] or (len(unit) > 1 and (unit[0] not in "mM" or text[0] == unit[0]))
