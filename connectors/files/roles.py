"""Roles and units of a table's columns: what the map states, and what their names tell.

Case counts where it carries meaning: mPa is not MPa, and T is not t.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import chain
from math import prod
from typing import Final

import polars as pl

from connectors.files.column_map import (
    COUNTS,
    DATE,
    LABEL,
    MOTIONS,
    SIZES,
    SPEED,
    TIME,
    UNITS,
    VELOCITY,
    ColumnMap,
    shortened,
)
from connectors.files.raw_table import RawTable, listed
from connectors.files.time_axis import CLOCK, is_text_of_time
from operators.fingertip import CELL_LIMIT, grid

_NAMES: Final = {  # usual names, without blanks and signs, in lower case
    TIME: "t|time|time[mun]s|timestamp|stamp|datetime|elapsed|elapsedtime|seconds|sec|millis|micros|ms|us"
    "|zeit|zeitstempel|uhrzeit|tiempo",
    DATE: "date|datum",
    SPEED: "speed|v|tcpspeed|geschwindigkeit",
    LABEL: "labels?|slip|isslip|slipping|schlupf|groundtruth",
}
_CELL: Final = re.compile(  # words before the number of a cell
    "s|c|p|b|counts?|cells?|taxels?|txl|baro|barometer|pressure|press|druck|sensors?|ch|channel|kanal|zelle|pad"
    "|druckzelle|electrode|el|adc|fsr|force|kraft|raw|value|state|observationstate"
)
_READING: Final = re.compile("|p|press|pressure|druck|raw|value")  # words after it
_NUMBERED: Final = re.compile(r"(.*?)(\d{1,3})(?:((?:[\W_]|[rcxRCX]){1,3})(\d{1,3}))?(\D*)")
_AXES: Final = [  # of a velocity: vx, TCP_vx, actual_TCP_speed_0 (UR), twist.linear.x (ROS)
    re.compile(f"(actual)?tcpspeed{number}|(actual)?(tcp)?{word[0]}{word[-1]}|(twist)?{word[1:]}")
    for number, word in enumerate(["vlinearx", "vlineary", "vlinearz", "wangularx", "wangulary", "wangularz"])
]
_WORDS: Final = {  # usual values of labels
    label: values.split("|")
    for label, values in {
        "slip": "slip|slipping|sliding|slide|rutscht|rutschen|gleiten|gleitet|1|true|ja|yes",
        "static": "static|no slip|no_slip|noslip|stick|stable|rest|hold|still|haften|haftet|ruhe|0|false"
        "|nein|no",
        "unknown": "unknown|unlabeled|unlabelled|-1|unbekannt|?",
    }.items()
}
SLIP_WORD: Final = re.compile("slip|slid|rutsch|gleit|schlupf", re.IGNORECASE)
_FINGERTIP: Final = re.compile(  # names of columns that tell which fingertip, or cell, measured a row
    "(?!$)(finger|fingertip|sensor|side|hand|pad|device|node|board|module|mux|port|bus|i2c|mac|topic|source"
    "|channel|ch|cell|taxel)?(id|index|name|number|nr|no|addr|address)?"
)
_FEW: Final = 20  # values of labels, or fingertips in such a column
_HEAD: Final = 20  # rows that tell what a column is
_NUMBER: Final = r"^[+-]?[\d.,]*\d[\deE.,+-]*$"
_SYNONYMS: Final = {  # of units, in lower case
    "s": "sec secs second seconds sek sekunden",
    "ms": "msec millis millisecond milliseconds",
    "us": "usec micros microsecond microseconds",
    "ns": "nsec nanos nanosecond nanoseconds",
    "min": "minute minutes",
    "h": "hour hours",
    "count": "counts raw lsb digit digits adc a.u. -",
    "N": "newton",
    "V": "volt volts",
    "ohm": "\u03c9",
    "kohm": "k\u03c9",
    **{f"{each}/s": f"{each}_s {each}ps {each}/sec" for each in ("m", "cm", "mm")},
}
_ALL_UNITS: Final = [unit for units in UNITS.values() for unit in units]
_UNITS: Final = {  # by text; in lower case unless m would become M, or one letter another unit
    **{each.lower(): each for each in _ALL_UNITS if each[0] not in "mM" and len(each) > 1},
    **{name: unit for unit, names in _SYNONYMS.items() for name in names.split()},
    **{each: each for each in _ALL_UNITS},
}
_TEMPERATURE: Final = re.compile(r"°.*|deg(rees)? ?[ckf]|celsius|kelvin|temp.*|[ckt]", re.IGNORECASE)
_SPEED: Final = re.compile(r"[^°]*([/^%*·⁻]|-1$)|(rpm|ips|fps|kmh|mph)$", re.IGNORECASE)  # may be its unit
_BRACKETS: Final = re.compile(r"(.+?)[ _]*[\[({<]\s*([^\])}>]*?)\s*[\])}>]")
_ENDING: Final = re.compile(r"(.+?)(?:[ _]+(?:in )?|\s*/\s*)([^\d\s_/\[\]]+(?:/s(?:ec)?)?|[cm]?m_s)")


@dataclass(frozen=True)
class CellGroup:
    """Columns that are numbered alike."""

    names: tuple[str, ...]  # in the order of their numbers
    rows: int  # of a layout, from names with row and column; 0: one number
    sure: bool  # they have a usual name of cells


def completed(table: RawTable, stated: ColumnMap) -> ColumnMap:
    """Return a map that is completed by columns with usual names.

    A time is required unless the map has a rate.
    """
    groups, found = cell_groups([*table.columns, *table.left_out]), dict[str, tuple[str, ...]]()
    mapped = {key: _matched(key, names, table) for key, names in stated.columns.items()}
    taken = {name for names in mapped.values() for name in names}
    free = [name for name in table.columns if name not in taken]
    groups = [group for group in groups if not {*group.names} & {*chain(*_axes(free))}]
    for quantity in SIZES:
        keys = [key for key in mapped if key.partition(".")[0] == quantity]
        found |= {key: mapped[key] for key in keys}
        moves = quantity in MOTIONS and any(stated.columns.get(key) or found.get(key) for key in MOTIONS)
        if quantity == COUNTS and not keys:
            found[COUNTS] = _cells(groups, table)
        elif not (keys or moves or (quantity == LABEL and stated.labelled)):
            found[quantity] = _usual(quantity, free, table)
    times = [table.columns[name] for name in found[TIME]]
    of_day = any(each.dtype == pl.Time or is_text_of_time(each, f"^{CLOCK}") for each in times)
    if DATE not in mapped and not of_day:
        dated = not times and TIME not in mapped and stated.rate is None  # a date with the time of day
        found[TIME], found[DATE] = found[DATE] if dated else found[TIME], ()
    if not found[TIME] and stated.rate is None and not stated.columns.get(TIME):
        reason = "no column is recognised as time; state time=..., or rate=... if it has none"
        table.add_problem(reason, about=TIME)
    found = {key: names for key, names in found.items() if names}
    used = {name for names in found.values() for name in names}
    unused = [each for each in free if each not in used]
    table.fixes += [""] if table.problems else []
    _check_interleaved(table, unused)
    if LABEL not in {*found, *stated.columns} and stated.labelled is None:
        for name in unused:
            words = table.columns[name].unique().cast(pl.String, strict=False).drop_nulls()
            if 1 < len(words) <= _FEW and any(map(SLIP_WORD.search, (name, *words))):
                table.warn(f"column {name} may have labels: state label={name}")
    units = _units(found, stated, table)
    columns = replace(stated, columns=found, units=units)
    table.suggested = [*_suggested(columns, unused, groups, table), *stated.stated]
    layout = next((group for group in groups if group.rows and group.names in found.values()), None)
    if layout is None or stated.layout is not None:
        return columns
    wide = len(layout.names) // layout.rows
    table.notes.append(f"layout {layout.rows}x{wide} by the names")
    return replace(columns, layout=grid(len(layout.names), wide))


def _check_interleaved(table: RawTable, unused: Sequence[str]) -> None:
    """Add the problem that rows of several fingertips alternate, by a column that tells the fingertip."""
    for name in filter(lambda each: _FINGERTIP.fullmatch(_word(each)), unused):
        column = table.columns[name]
        many, changes = column.n_unique(), int(column.rle_id()[-1])
        if 1 < many <= _FEW and changes > max(len(column) / 4, 2 * many - 1):
            split = f"for (one,), rows in frame.group_by({name!r}): import_frame(rows, OUT, f'NAME-{{one}}')"
            reason = f"column {name} alternates between {many} fingertips: import each in Python, with"
            table.add_problem(f"{reason} {split}; or delete the column, if it does not tell fingertips")


def cell_groups(names: Sequence[str]) -> list[CellGroup]:
    """Return the columns that are numbered alike from 0 or 1, or by row and column; never temperatures."""
    found: dict[tuple[str, ...], dict[tuple[int, ...], str]] = {}
    for name in names:
        stem, unit = split_unit(COUNTS, name)
        match = _NUMBERED.fullmatch(stem)
        if match and not has_temperature(name):
            numbers = tuple(int(each) for each in match.group(2, 4) if each)
            found.setdefault((match[1], match[3] or "", match[5], unit), {})[numbers] = name
    groups = list[CellGroup]()
    words = {_word(name): name for name in names if not any(_has_usual_name(each, name) for each in _NAMES)}
    for (before, _, after, unit), members in found.items():
        numbered = sorted(members)
        axes = [sorted({*numbers}) for numbers in zip(*numbered, strict=True)]
        whole = all(axis[0] <= 1 and axis == [*range(axis[0], axis[-1] + 1)] for axis in axes)
        if whole and prod(map(len, axes)) == len(numbered) <= CELL_LIMIT:
            names, rows = tuple(members[key] for key in numbered), len(axes[0]) if len(axes) > 1 else 0
            sure = bool(_CELL.fullmatch(_word(before)) and _READING.fullmatch(_word(after)))
            again = numbered[0] == (1,) and before.endswith((".", "_", " "))  # p, p.1, p.2
            first = words.get(_word(before + after + unit)) if again else None
            groups.append(CellGroup((*filter(None, [first]), *names), rows, sure))
    return groups


def unit_in(text: str, quantities: Collection[str] = UNITS.keys()) -> str:
    r"""Return the unit that a text is; empty if it is none of the quantities.

    >>> unit_in("KPA"), unit_in("mPa"), unit_in("MPA"), unit_in("\u00b5s"), unit_in("seconds")
    ('kPa', 'mPa', '', 'us', 's')
    """
    text = text.strip().replace("\u00b5", "u").replace("\u03bc", "u")
    unit = _UNITS.get(text) or _UNITS.get(text.lower(), "")
    return unit if any(unit in UNITS.get(quantity, ()) for quantity in quantities) else ""


def split_unit(quantity: str, name: str) -> tuple[str, str]:
    """Split the unit off a column name; an empty unit: it has none.

    An unknown unit of cells in brackets is kept as it is. After an underscore or a blank, one letter is a
    unit of time only.

    >>> split_unit("time", "t_ms"), split_unit("counts", "cell 1 [kPa]"), split_unit("counts", "b0_T")
    (('t', 'ms'), ('cell 1', 'kPa'), ('b0_T', ''))
    """
    if (match := _BRACKETS.fullmatch(name)) and not re.fullmatch(r"\d[\d\W]*", match[2]):
        unit = unit_in(match[2], (quantity,))
        if unit or (match[2] and (quantity == COUNTS or (quantity in MOTIONS and _SPEED.match(match[2])))):
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


def has_temperature(name: str) -> bool:
    """Return True if the name or unit of a numbered column is that of a temperature."""
    stem, unit = split_unit(COUNTS, name)
    degrees = unit != "T" and _TEMPERATURE.fullmatch(unit)
    return bool(degrees or _TEMPERATURE.fullmatch(_suffix(stem)) or _word(name).startswith("temp"))


def label_values(labels: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return the label by value of a label column: the usual words and numbers, unless `labels` has others.

    If only those of slip are stated, all other values are static.
    """
    usual = {} if {*labels} == {"slip"} else _WORDS
    words = {label: usual[label] for label in usual if label not in labels} | dict(labels)
    return {label_value(value): label for label, values in words.items() for value in values}


def label_value(text: str) -> str:
    """Return a value of a label column as it is compared."""
    with suppress(ValueError):
        if (number := float(text)).is_integer():
            return str(int(number))
    return text.strip().lower()


def _matched(key: str, names: Sequence[str], table: RawTable) -> tuple[str, ...]:
    """Return the columns that a map names, or none; a pattern becomes those that match, by their numbers."""
    found, before = list[str](), len(table.problems)
    for name in names:
        if name in table.columns:
            found.append(name)
        elif matches := [each for each in table.columns if set("*?") & {*name} and fnmatchcase(each, name)]:
            found += sorted(matches, key=lambda each: [int(part) for part in re.findall(r"\d+", each)])
        elif name in table.left_out:
            table.add_problem(f"column {name} cannot be used: {table.left_out[name]}")
        else:
            reason = f"there is no column {name}; the columns are {listed([*table.columns])}"
            table.add_problem(reason, about=key)
    for name in [each for each in found if found.count(each) > 1]:
        table.add_problem(f"column {name} cannot be two cells")
    if len(found) not in (0, *(SIZES.get(key) or range(CELL_LIMIT + 1))):
        table.add_problem(f"{key} matches {len(found)} columns", about=key)
    return tuple(found) if len(table.problems) == before else ()


def _usual(quantity: str, free: Sequence[str], table: RawTable) -> tuple[str, ...]:
    """Return those of the `free` columns with a usual name of a quantity; none, if there are none."""
    if quantity == VELOCITY:
        found = _axes(free)
        size = next((size for size in (6, 3) if all(found[:size])), 0)
        if several := [names for names in found[:size] if names[1:]]:
            text = f"columns {' and '.join(several[0])} may be the same component of the velocity"
            table.add_problem(f"{text}; state velocity=...", about=quantity)
        return tuple(each[0] for each in found[:size])
    names = [name for name in free if _has_usual_name(quantity, name)]
    names = [each for each in names if each != "T" or "t" not in names]  # T may be a temperature
    if len(names) > 1:
        text = f"columns {' and '.join(names)} may be {quantity}; state one, as {quantity}={names[0]}"
        table.add_problem(text, about=quantity)
    return tuple(names[:1])


def _axes(free: Sequence[str]) -> list[list[str]]:
    """Return the columns with a usual name of each component of a velocity."""
    words = {each: _word(split_unit(VELOCITY, each)[0]) for each in free if not re.search("deg|rpm", each)}
    return [[name for name in words if axis.fullmatch(words[name])] for axis in _AXES]


def _has_usual_name(quantity: str, name: str) -> bool:
    usual = re.fullmatch(_NAMES[quantity], _word(split_unit(quantity, name)[0]))
    return bool(usual) and name != "V"  # volts


def _cells(groups: Sequence[CellGroup], table: RawTable) -> tuple[str, ...]:
    """Return the cells: the only group of columns with a usual name; groups of one column only if alone."""
    sure = [group for group in groups if group.sure]
    sure = [group for group in sure if len(group.names) > 1] or sure
    if len(sure) == 1 and re.search(r"\d", sure[0].names[0]):  # else the first may be their sum
        return _matched(COUNTS, sure[0].names, table)
    several = [shortened(group.names) for group in sure or groups]
    of_each = ",".join(f"counts.{finger}={names}" for finger, names in enumerate(several))
    more = f", or of {len(several)} fingertips {of_each:.200}" if len(several) > 1 else ""
    bad = "; ".join(f"{name} cannot be used: {reason}" for name, reason in table.left_out.items())
    who = f"{' or '.join(several):.200} may be the cells" if several else "no columns are recognised as cells"
    table.add_problem(f"{who}; state counts=...{more}{f' ({bad:.200})' if bad else ''}", about=COUNTS)
    return ()


def _units(found: Mapping[str, Sequence[str]], stated: ColumnMap, table: RawTable) -> dict[str, str]:
    """Return the unit of each quantity: stated, in the names or in a row of units; else the usual one."""
    units = dict(stated.units)
    for quantity, usual in UNITS.items():
        names = [name for key, each in found.items() if key.partition(".")[0] == quantity for name in each]
        if not names or quantity in units:
            continue
        known = dict[str, str]()  # first column by unit
        for name in names[:3] if quantity == VELOCITY else names:  # an angular velocity is in rad/s
            known.setdefault(_unit_of(quantity, name, table), name)
        unit = next(filter(None, known), "")
        like = [each for each in usual if each.casefold() == unit.casefold()]
        choices, problem = like or ([] if quantity == COUNTS else [*usual]), ""
        if len(known) > 1:
            columns = " and ".join(f"{name} has {each or 'no unit'}" for each, name in known.items())
            problem = f"units differ, {columns}: convert them to one, or state units.{quantity}=..."
        elif quantity == COUNTS and any(map(has_temperature, (*names, *(f"x [{each}]" for each in known)))):
            problem = f"column {names[0]} is a temperature, not a cell (or state units.counts=...)"
        elif unit and choices and unit not in choices:
            must_be = f"must be {' or '.join(choices)}"
            problem = f"unit {unit} of column {names[0]} {must_be}: state units.{quantity}=..., or convert it"
            problem += f" (or leave it out by {quantity}=)" if quantity in MOTIONS else ""
        elif quantity == TIME and not unit:
            unit = unit_in(_word(names[0]).removeprefix("time"), (TIME,))
        if problem:
            table.add_problem(problem, about=quantity)
            unit = next(iter(like or usual))
        if unit or quantity != TIME:
            units[quantity] = unit or next(iter(usual))
    return units


def _unit_of(quantity: str, name: str, table: RawTable) -> str:
    """Return the unit in a column's name or below it; empty: it has none."""
    below = table.units.get(name, "").strip("-")
    unit = split_unit(quantity, name)[1] or split_unit(quantity, f"x [{below}]")[1]
    return unit or ("" if is_text_of_time(table.columns[name]) else below)


def _suggested(
    columns: ColumnMap, free: Sequence[str], groups: Sequence[CellGroup], table: RawTable
) -> list[str]:
    """Return the items of a map that is made of the table's own columns."""
    items = [f"{key}={shortened(names)}" for key, names in columns.columns.items()]
    if TIME not in columns.columns and columns.rate is None:
        name = next((name for name in free if _rises(table.columns[name])), "")
        items.insert(0, f"time={name}" if name else "rate=ROWS_PER_SECOND")
        free = [each for each in free if each != name]
    if not columns.cell_names:
        values = {name: table.columns[name].cast(pl.Float64, strict=False).unique() for name in free}
        free = [name for name in free if {*values[name]} != {0, 1}]  # those may be labels
        several = [group.names for group in groups if len(group.names) > 1 and {*group.names} <= {*free}]
        others = {name for name in free for quantity in _NAMES if _has_usual_name(quantity, name)}
        others |= {name for name in free if has_temperature(name) or _FINGERTIP.fullmatch(_word(name))}
        heads = {name: table.columns[name].head(_HEAD).cast(pl.String) for name in free if name not in others}
        numbers = tuple(name for name, head in heads.items() if head.str.contains(_NUMBER).all())
        if not several and len(numbers) <= CELL_LIMIT and not table.left_out:  # a list of all cells or none
            several = [numbers]
        if [len(each) for each in several] == 2 * [len(several[0]) if several else 0]:
            items += [f"counts.{finger}={shortened(names)}" for finger, names in enumerate(several)]
        else:
            cells = shortened(several[0]) if len(several) == 1 else ""
            items.append(f"counts={cells or 'NAME,NAME'}")
    return items


def _rises(column: pl.Series) -> bool:
    """Return True for dates, and for numbers that rise, but not in steps of 1, which count the rows."""
    text = column.str.replace(",", ".", literal=True) if column.dtype == pl.String else column
    steps = text.cast(pl.Float64, strict=False).diff().drop_nulls()
    return is_text_of_time(column) or bool(len(steps) and (steps > 0).all() and (steps != 1).any())


def _word(name: str) -> str:
    """Return a name without blanks and signs, in lower case."""
    return re.sub(r"[\W_]+", "", name).lower()


def _suffix(name: str) -> str:
    """Return the word after the last number of a name; of ``b0_T`` it is ``t``."""
    return _word(re.split(r"\d", name)[-1]) if re.search(r"\d", name) else ""
