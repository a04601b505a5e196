"""Source files of a recording as the table of columns that a recipe describes."""

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from connectors.files.column_map import TIME
from connectors.files.csv_table import read_csv
from connectors.files.trace_table import TraceTable
from flows.lab.recipes.dataset_recipe import DatasetRecipe, SourceRecording
from flows.report.table import counted
from operators.batch import Flags, Reals
from operators.errors import InputError


def source_table(recipe: DatasetRecipe, recording: SourceRecording, folder: Path) -> TraceTable:
    """Return the columns of a recording that the import needs: those of the source, and derived ones.

    Times are in ns.

    Args:
        recipe: The recipe.
        recording: One of its recordings.
        folder: Folder of the verified source files.

    Raises:
        InputError: if a file is not a table, has no such column or an invalid value, or the files of a
            recording have different numbers of rows.
    """
    sources, skipped = _sources(recipe, recording, folder)
    column_map = recipe.column_map
    times = {name: column_map.units.get(TIME, "s") for name in column_map.columns.get(TIME, ())}
    values: dict[str, Reals] = {
        name: table.reals(column) for name, (table, column) in sources.items() if name not in times
    }
    for name, expression in recipe.expressions().items():
        values[name] = expression.evaluate(values)
    stamps = {name: sources[name][0].times(sources[name][1], unit) for name, unit in times.items()}
    paths = [file.path for file in recording.files]
    checksums = "".join(file.sha256 for file in recording.files)
    return TraceTable(
        {**values, **stamps},
        paths[0] if len(paths) == 1 else recording.name,
        where=f"recipe {recipe.name}, {recording.name}",
        notes=[f"{counted(skipped, 'row')} with invalid values left out"] if skipped else [],
        sha256=checksums if len(paths) == 1 else hashlib.sha256(checksums.encode()).hexdigest(),
    )


def _sources(
    recipe: DatasetRecipe, recording: SourceRecording, folder: Path
) -> tuple[Mapping[str, tuple[TraceTable, str]], int]:
    """Return the table and the column of each name of the recipe, and the number of rows left out."""
    tables = {
        file.name: read_csv(folder / file.path, ",", lenient=recipe.skip_invalid) for file in recording.files
    }
    first = next(iter(tables.values()))
    for table in tables.values():
        if len(table) != len(first):
            raise InputError(table.where, f"has {len(table)} rows, {first.where} has {len(first)}")
    found = dict[str, tuple[str, str]]()
    for name, column in recipe.columns.items():
        file, rest = (recording.files[0].name, column)
        if len(tables) > 1:
            file, _, rest = column.partition(":")
        tables[file].header.check(rest)
        found[name] = file, rest
    good: Flags = np.ones(len(first), np.bool_)
    if recipe.skip_invalid:
        for file, column in found.values():
            good &= np.isfinite(tables[file].reals(column, lenient=True))
        tables = {file: table.selected(good) for file, table in tables.items()}
    return {name: (tables[file], column) for name, (file, column) in found.items()}, int((~good).sum())
