"""Recordings in files of many formats, drawn at random, with the values that they contain."""

import datetime as dt
import gzip
import io
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
import polars as pl

from operators.batch import Reals, Times, s

EPOCH: Final = 1_742_999_346_123_000_000  # ns
WORDS: Final = (("static", "slip"), ("0", "1"), ("false", "true"), ("ruhe", "rutscht"), ("rest", "sliding"))
READINGS: Final = (  # unit, decimal places, level
    *(("count", 0, 500), ("count", 0, 30000), ("kPa", 2, 101.3), ("kPa", 3, 101.3), ("Pa", 0, 101300)),
    *(("hPa", 1, 1013), ("mPa", 0, 300), ("N", 3, 0), ("V", 4, 1.6), ("MPa", 5, 0.1013), ("mbar", 2, 1013)),
)
CELLS: Final = ("p{}", "taxel{}", "cell {}", "b{}", "Sensor_{}", "druck{}", "taxel_{r}_{c}", "ch{:02}")
ABOVE: Final = ("", "", "", "# made in 2026\n", "Recording;stroke 3\nRate;100\n\n", "A title\n", "sep=;\n")
Draw: TypeAlias = random.Random


@dataclass
class GeneratedFile:
    """A recording and its file."""

    content: bytes
    time: Times  # (n,) ns
    readings: Reals  # (n, cells); NaN: missing
    unit: str
    labels: list[int]  # (n,) 1 slip, 0 static, -1 unknown
    name: str = "trace.csv"
    tolerance: int = 0  # ns, by which the file rounds the times
    columns: str = ""  # map that the format needs
    refusable: bool = False  # the format is damaged or ambiguous, so that an error is right
    about: list[str] = field(default_factory=list[str])  # its format


def generated(seed: int) -> GeneratedFile:
    """Draw a file."""
    draw = Draw(seed)
    rate = draw.choice((50, 100, 200, 400, 1000, 1673))
    rows, cells = draw.randint(60, 300), draw.choice((1, 2, 3, 4, 6, 9, 16))
    unit, places, level = draw.choice(READINGS)
    step = 10.0**-places
    noise = np.random.default_rng(seed).integers(-9, 10, (rows, cells)) * step
    press = 300 * step * (np.arange(rows) > rows // 2)[:, None]
    readings = np.round(level + press + noise + 50 * step * np.arange(cells), places)
    time = np.rint(np.arange(rows) * (s / rate)).astype(np.int64)
    words = draw.choice((None, *WORDS))
    labels = [int(k > rows // 2) if words else -1 for k in range(rows)]
    file = GeneratedFile(b"", time, readings, unit, labels)
    names = _cell_names(draw, cells, unit, file)
    if draw.random() < 0.12:
        _typed(draw, file, names, words)
    else:
        _text(draw, file, names, words, places)
    if draw.random() < 0.2:
        _damaged(draw, file)
    return file


def write(file: GeneratedFile, folder: Path) -> Path:
    """Write a file into a folder."""
    path = folder / file.name
    path.write_bytes(file.content)
    return path


def _cell_names(draw: Draw, cells: int, unit: str, file: GeneratedFile) -> list[str]:
    """Return the names of the cells; without a unit in them, the map states it."""
    first, style = draw.choice((0, 1)), draw.choice(CELLS)
    wide = next(each for each in (4, 3, 2, 1) if cells % each == 0)
    stems = [style.format(k + first, r=k // wide + first, c=k % wide + first) for k in range(cells)]
    place = draw.choice((" [{}]", "_{}", " ({})", "/{}", "")) if unit != "count" else ""
    if unit in ("N", "V") and place == "_{}":
        place = " [{}]"
    if unit != "count" and not place:
        file.columns = f"units.counts={unit}"
    file.about.append(f"cells {stems[0]}{place}")
    return [stem + place.format(unit) for stem in stems]


def _typed(draw: Draw, file: GeneratedFile, names: list[str], words: tuple[str, str] | None) -> None:
    """Write a Parquet file."""
    kinds = (("t", file.time / s), ("time_ns", file.time), ("time [us]", file.time / 1000))
    name, values = draw.choice((*kinds, ("timestamp", file.time + EPOCH)))
    file.time = file.time + EPOCH * (name == "timestamp")
    file.tolerance = 1
    columns: dict[str, object] = {name: values, **dict(zip(names, file.readings.T, strict=True))}
    if words:
        columns["label"] = [words[each] for each in file.labels]
    pl.DataFrame(columns).write_parquet(buffer := io.BytesIO())
    file.content = buffer.getvalue()
    file.name = draw.choice(("trace.parquet", "trace.PARQUET", "trace", "a.csv"))
    file.about.append("parquet")


def _times(draw: Draw, file: GeneratedFile, number: Callable[[float, int], str]) -> dict[str, list[str]]:
    """Return the columns of the times in a format."""
    kinds = "s s ms us ns epoch iso german us-date two clock wrap whole-ms"
    kind, zeit = draw.choice(kinds.split()), draw.choice(("t", "time", "Zeit", "timestamp"))
    file.about.append(kind)
    if kind in ("s", "ms", "us", "ns"):
        scale = {"s": s, "ms": 1_000_000, "us": 1000, "ns": 1}[kind]
        file.tolerance = 500_000 if kind == "s" else 1000
        name = draw.choice((f"{zeit}_{kind}", f"{zeit} [{kind}]", f"{zeit} ({kind})"))
        digits = {"s": 6, "ms": 3}.get(kind, 0)
        name = "t" if kind == "s" and draw.random() < 0.3 else name
        return {name: [number(each / scale, digits) for each in file.time]}
    if kind in ("wrap", "whole-ms"):
        file.tolerance = 1000 if kind == "wrap" else 1_000_000
        span, first = (2**32, 2**32 - 30_000) if kind == "wrap" else (10**12, 10_114)
        times = [(each // file.tolerance + first) % span for each in file.time.tolist()]
        return {f"{zeit}_{'us' if kind == 'wrap' else 'ms'}": [*map(str, times)]}
    file.time = file.time + EPOCH
    if kind == "epoch":
        file.tolerance = draw.choice((1_000_000, 1000, 1))
        name = draw.choice(("timestamp", "t", "time"))
        return {name: [str(each // file.tolerance) for each in file.time.tolist()]}
    file.tolerance = 1_000_000
    days = [dt.datetime.fromtimestamp(each / s, dt.UTC) for each in file.time.tolist()]
    clock = [each.strftime("%H:%M:%S.%f")[:-3] for each in days]
    if draw.random() < 0.5:
        clock = [each.replace(".", ",") for each in clock]
    if kind == "clock":
        file.time -= int(days[0].replace(hour=0, minute=0, second=0, microsecond=0).timestamp()) * s
        return {zeit: clock}
    form = {"german": "%d.%m.%Y", "us-date": "%m/%d/%Y"}.get(kind, "%Y-%m-%d")
    dates = [each.strftime(form) for each in days]
    if kind == "two":
        return {"Date": dates, "Time": clock}
    gap = draw.choice((" ", "T")) if kind == "iso" else " "
    return {zeit: [date + gap + each for date, each in zip(dates, clock, strict=True)]}


def _text(
    draw: Draw, file: GeneratedFile, names: list[str], words: tuple[str, str] | None, places: int
) -> None:
    """Write a text file."""
    separator = draw.choice(",;\t| ")
    comma = separator != "," and draw.random() < 0.4
    thousands = draw.choice(("", "", "", "", "." if comma else ",", "'"))
    thousands = "" if separator in (thousands, " ") else thousands

    def number(value: float, digits: int) -> str:
        text = f"{value:,.{digits}f}".replace(",", "\0").replace(".", "," if comma else ".")
        return text.replace("\0", thousands)

    columns = _times(draw, file, number)
    for name, cell in zip(names, file.readings.T.tolist(), strict=True):
        columns[name] = [number(each, places) for each in cell]
    if draw.random() < 0.2:
        columns |= {f"{name}_temp": [number(25.5, 1)] * len(file.time) for name in ("b0", "b1")}
    if words:
        columns[draw.choice(("label", "slip"))] = [words[each] for each in file.labels]
    values = [each for column in columns.values() for each in column]
    blanks = any(" " in each for name, column in columns.items() for each in (name, column[0]))
    if (separator == " " and blanks) or (separator == "," and any("," in each for each in values)):
        separator = ";"
    above = draw.choice(ABOVE) if separator not in "\t " else draw.choice(ABOVE[:-1])
    end = draw.choice(("", "", separator if separator != " " else ""))
    rows = [separator.join(row) + end for row in zip(*columns.values(), strict=True)]
    header = separator.join(columns) + draw.choice(("", end))
    text = above.replace(";", separator) + "\n".join([header, *rows, ""])
    text = text.replace("\n", draw.choice(("\n", "\n", "\r\n", "\r")))
    encoding = draw.choice(("utf-8", "utf-8", "utf-8-sig", "cp1252"))
    file.content = text.encode(encoding)
    file.about += [repr(separator), "comma" if comma else "point", repr(thousands), encoding, repr(above)]
    signs = any("," in each or "." in each for each in values)
    numbers = [each for each in values if ":" not in each]
    doubtful = signs and not any(_is_plain(each, "," if comma else ".") for each in numbers)
    file.refusable |= doubtful or thousands != ""
    if draw.random() < 0.15:
        file.content, file.name = gzip.compress(file.content), "trace.csv.gz"


def _is_plain(text: str, sign: str) -> bool:
    """Return True if a number proves its sign of decimals."""
    whole, found, rest = text.partition(sign)
    return bool(found) and (len(rest) != 3 or whole in ("0", "-0", "") or len(whole) > 3)


def _damaged(draw: Draw, file: GeneratedFile) -> None:
    """Damage a file; an error is right then, another value is not."""
    kind, content = draw.choice(("letter", "field", "cut", "nul", "gzip")), file.content
    file.about.append(f"damage {kind}")
    file.refusable = True
    at = draw.randrange(len(content) // 2, len(content))
    if kind == "cut":
        file.content = content[:at]
    elif kind == "nul":
        file.content = content[:at] + bytes(8) + content[at:]
    elif kind == "gzip":
        packed = gzip.compress(content)
        cut = draw.randrange(20, len(packed))
        file.content = packed[:cut] + bytes(10) + packed[cut + 10 :]
        file.name = "trace.csv.gz"
    elif kind == "letter" and content.isascii():
        file.content = content[:at] + b"x" + content[at:]
    elif kind == "field" and content.isascii():
        end = content.find(b"\n", at)
        file.content = content[:end] + b",7,7;8;8\t9\t9|1|1" + content[end:] if end > 0 else content
