"""Recipes of public datasets as TOML files; `shipped/` holds those that ship with the package."""

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal
from urllib.parse import quote

from connectors.files.column_map import COUNTS, LABEL, SPEED, VELOCITY, ColumnMap
from connectors.files.pad import Pad
from flows.lab.recipes.expression import Expression
from flows.lab.toml_file import parse_toml, shipped_text
from operators.checks import check_above, check_between, check_choice
from operators.errors import ParameterError

SHIPPED: Final = {path.stem: path for path in sorted((Path(__file__).parent / "shipped").glob("*.toml"))}
FILE_LIMIT: Final = 1 << 30  # bytes of a source file
DEPTH: Final = 20  # parts of a path

_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")  # of a folder
_REPOSITORY: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*/[A-Za-z0-9._-]+")
_COMMIT: Final = re.compile(r"[0-9a-f]{40}")
_SHA256: Final = re.compile(r"[0-9a-f]{64}")
_PART: Final = re.compile(r"[^/\\:\x00-\x1f\x7f]{1,200}")  # of a path


@dataclass(frozen=True, slots=True)
class SourceFile:
    """Published file of a recording.

    Args:
        path: Path in the repository, with ``/``; never absolute, never with ``..``.
        bytes: Size.
        sha256: Checksum, hex.

    Raises:
        ParameterError: if a value is invalid.
    """

    path: str
    bytes: int
    sha256: str

    def __post_init__(self) -> None:
        parts = self.path.split("/")
        if len(parts) > DEPTH or not all(_PART.fullmatch(part) and part.strip(". ") for part in parts):
            must_be = "a path inside the repository, such as data/one.csv: no .., no leading /"
            raise ParameterError("recipe", "path", self.path, must_be)
        check_between("recipe", "bytes", self.bytes, 1, FILE_LIMIT)
        if not _SHA256.fullmatch(self.sha256):
            raise ParameterError("recipe", "sha256", self.sha256, "64 digits, 0 to 9 and a to f")

    @property
    def name(self) -> str:
        """Last part of the path."""
        return self.path.rpartition("/")[2]


@dataclass(frozen=True, slots=True)
class SourceRecording:
    """Recording of a public dataset: one file, or several whose rows belong together.

    Args:
        name: Name of the session.
        files: Its files.
        group: Surface, object or other group of the recording; benchmarks never split one.

    Raises:
        ParameterError: if a value is invalid.
    """

    name: str
    files: tuple[SourceFile, ...]
    group: str = ""

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ParameterError("recipe", "name", self.name, "letters, digits, . _ and -, 128 at most")
        names = [file.name for file in self.files]
        if not names or len({*names}) < len(names):
            raise ParameterError("recipe", "files", names, "one file, or several of different names")


@dataclass(frozen=True)
class DatasetRecipe:
    """Description of a public dataset: source, licence, columns and labels. The data is not part of it.

    Args:
        name: Name of the recipe and of its folder.
        title: Sensor, task and rate in one line.
        repository: GitHub repository, OWNER/NAME.
        commit: Commit of the files, 40 hex digits; may be empty in a recipe without recordings.
        licence: SPDX identifier, or ``none`` if the source states no licence.
        terms: Consequence of the licence for users, in one or two sentences.
        citation: Work to cite.
        url: Folder of the files on another server, https; default: the commit on GitHub.
        about: Description of the recordings.
        assumed: Assumptions of the recipe that the source does not confirm.
        rate: Samples per second, Hz.
        resolution: Units per stored count, where the counts have a unit.
        layout: Positions of the cells, as in ``slipflow import --layout``.
        range: Readings at the lowest and at the highest pressure, as in ``slipflow import --range``.
        zeroed: Counts are relative to the unloaded or resting fingertip.
        split: Unit that a benchmark holds out as a whole: every ``group``, or every ``recording``.
        group: Kind of the groups, such as surface.
        label_rule: Origin of the labels.
        columns: Names used below, and the source's column of each; of a recording with several files
            ``FILE:COLUMN``.
        derived: Further columns and their `Expression`, computed in this order.
        map: Columns with the ``time``, the ``counts`` and so on, as in ``slipflow import --map``.
        units: Their units, as in ``slipflow import --units``.
        skip_invalid: Leave out rows in which a column that is used is not a number.
        not_run_here: The authors of slipflow have not run this recipe on the source files.
        recordings: Recordings; none in a recipe that only documents a dataset.

    Raises:
        ParameterError: if a value is invalid.
    """

    name: str
    title: str
    repository: str
    commit: str
    licence: str
    terms: str
    citation: str
    url: str = ""
    about: str = ""
    assumed: str = ""
    rate: float = 0.0  # Hz
    resolution: float | None = None
    layout: str = ""
    range: str = ""
    zeroed: bool = False
    split: Literal["group", "recording"] = "recording"
    group: str = "recording"
    label_rule: str = ""
    columns: Mapping[str, str] = field(default_factory=dict[str, str])
    derived: Mapping[str, str] = field(default_factory=dict[str, str])
    map: Mapping[str, str] = field(default_factory=dict[str, str])
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    skip_invalid: bool = False
    not_run_here: bool = False
    recordings: tuple[SourceRecording, ...] = ()

    def __post_init__(self) -> None:
        self._check_source()
        _ = self.pad  # raises, if invalid
        if self.recordings:
            check_above("recipe", "rate", self.rate, 0, "Hz")
            self._check_columns()
        for name, texts in (
            ("recordings", [each.name for each in self.recordings]),
            ("paths", [each.path for each in self.files]),
        ):
            if len({text.casefold() for text in texts}) < len(texts):
                raise ParameterError("recipe", name, f"{len(texts)} names", "different, also in lower case")

    @property
    def files(self) -> tuple[SourceFile, ...]:
        """Files of all recordings."""
        return tuple(file for recording in self.recordings for file in recording.files)

    @property
    def bytes(self) -> int:
        """Size of all files."""
        return sum(file.bytes for file in self.files)

    @property
    def base(self) -> str:
        """URL of the folder of the files, with a final ``/``."""
        raw = f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/"
        return f"{self.url.rstrip('/')}/" if self.url else raw

    @property
    def page(self) -> str:
        """URL of the source for a browser."""
        repository = f"https://github.com/{self.repository}"
        return self.url or (f"{repository}/tree/{self.commit}" if self.commit else repository)

    @property
    def labelled(self) -> bool:
        """True if the samples have labels, of the source or by speed."""
        return any(self.map.get(name) for name in (LABEL, SPEED, VELOCITY))

    @property
    def column_map(self) -> ColumnMap:
        """Map of the columns for the import."""
        columns, units = (
            ",".join(f"{name}={value}" for name, value in each.items()) for each in (self.map, self.units)
        )
        return ColumnMap.parse(columns, units)

    @property
    def pad(self) -> Pad:
        """Layout and range of the fingertip."""
        return Pad.parse(self.layout, self.range)

    @property
    def digest(self) -> str:
        """Checksum of everything that determines the imported dataset, hex."""
        parts = self.rate, self.resolution, self.zeroed, self.skip_invalid, self.recordings
        tables = [[*table.items()] for table in (self.columns, self.derived, self.map, self.units)]
        pad = [self.pad] if self.layout or self.range else []  # without: the checksum of earlier versions
        return hashlib.sha256(repr((self.name, parts, tables, *pad)).encode()).hexdigest()

    def link(self, file: SourceFile, mirror: str | None = None) -> str:
        """Return the URL of a file, at the source or on a mirror."""
        return f"{mirror.rstrip('/')}/{quote(file.path)}" if mirror else self.base + quote(file.path)

    def expressions(self) -> dict[str, Expression]:
        """Return the expressions of the derived columns, in order.

        Raises:
            ParameterError: if one is invalid.
        """
        return {name: Expression(text) for name, text in self.derived.items()}

    def _check_source(self) -> None:
        checks = (
            ("name", self.name, _NAME, "letters, digits, . _ and -, 128 at most"),
            ("repository", self.repository, _REPOSITORY, "OWNER/NAME on GitHub"),
            ("commit", self.commit, _COMMIT, "40 digits, 0 to 9 and a to f"),
        )
        for name, value, pattern, must_be in checks:
            if not (pattern.fullmatch(value) or (name == "commit" and not (value or self.recordings))):
                raise ParameterError("recipe", name, value, must_be)
        if self.url and not self.url.startswith("https://"):
            raise ParameterError("recipe", "url", self.url, "an address that begins with https://")
        if not self.recordings and not self.not_run_here:
            must_be = "listed, or not_run_here = true in a recipe that only documents a dataset"
            raise ParameterError("recipe", "recordings", [], must_be)

    def _check_columns(self) -> None:
        known = {*self.columns}
        for name, expression in self.expressions().items():
            if missing := expression.names - known:
                raise ParameterError("recipe", f"derived.{name}", expression.text, _among(missing, known))
            known.add(name)
        for name, columns in self.column_map.columns.items():
            if missing := frozenset(columns) - known:
                raise ParameterError("recipe", f"map.{name}", ",".join(columns), _among(missing, known))
        self.pad.check_cells("recipe", len(self.column_map.columns.get(COUNTS, ())))
        check_choice("recipe", "split", self.split, ("group", "recording"))
        for recording in self.recordings:
            names = {file.name for file in recording.files}
            for name, column in self.columns.items():
                if len(names) > 1 and column.partition(":")[0] not in names:
                    must_be = f"FILE:COLUMN, with a file of {recording.name}: {', '.join(sorted(names))}"
                    raise ParameterError("recipe", f"columns.{name}", column, must_be)
            if self.split == "group" and not recording.group:
                raise ParameterError("recipe", "group", "", f"given for {recording.name}: split is group")


def recipe_file(recipe: str) -> tuple[Path, str]:
    """Return the path and the text of a recipe: the name of a shipped one, or a TOML file.

    Raises:
        ParameterError: if there is no shipped recipe of that name.
        InputError: if the file cannot be read.
    """
    return shipped_text("fetch", "recipe", recipe, SHIPPED)


def load_recipe(recipe: str) -> DatasetRecipe:
    """Return a recipe: the name of a shipped one, or a TOML file.

    >>> load_recipe("strokes").group
    'surface'

    Raises:
        ParameterError: if there is no shipped recipe of that name, or a key has an invalid value.
        InputError: if the file cannot be read, is not TOML, has an unknown key or lacks a required one.
    """
    path, text = recipe_file(recipe)
    return parse_toml(DatasetRecipe, path, text)


def shipped_recipes() -> Iterator[DatasetRecipe]:
    """Yield the shipped recipes: those that can be fetched, then those that document a dataset."""
    yield from sorted(map(load_recipe, SHIPPED), key=lambda each: (each.not_run_here, each.name))


def _among(missing: frozenset[str], known: set[str]) -> str:
    return f"of known columns ({', '.join(sorted(missing))} is none of {', '.join(sorted(known))})"
