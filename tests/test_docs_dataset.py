"""docs/reference/dataset.md is the contract that the code keeps."""

import json
import re
from contextlib import chdir
from dataclasses import fields
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
import pytest

from operators import Labelled
from operators.health import FaultKind
from storage import LabelSpan, Session
from storage.layout import TABLES
from storage.schema import schema
from tests.connectors.web.reading import slip
from tests.pages import ROOT, table
from tests.storage.made import new_batch, record

PAGE = ROOT / "docs" / "reference" / "dataset.md"
SCHEMAS: dict[str, Any] = {each.name: schema(each) for each in TABLES}


def written(kind: pa.DataType) -> str:
    """A type as the page writes it."""
    if isinstance(kind, pa.DictionaryType):
        return "string"
    return re.sub(r"fixed_size_list<item: (\w+)>", r"\1", str(kind))


def unit(metadata: dict[bytes, bytes] | None) -> str:
    """The unit of a column, as the page writes it."""
    return (metadata or {}).get(b"unit", b"").decode()


def read_as_on_the_page(number: int, folder: Path) -> list[tuple[str, int]]:
    """Run an example of the section on other programs; return session and time (ns) of the rows it read."""
    section = PAGE.read_text().split("\n## Reading with other programs\n")[1].split("\n## ")[0]
    found: dict[str, Any] = {}
    with chdir(folder):
        exec(re.findall(r"^```python\n(.*?)^```$", section, re.DOTALL | re.MULTILINE)[number], found)  # noqa: S102
        samples = found["samples"]
        if isinstance(samples, duckdb.DuckDBPyRelation):
            samples = samples.to_arrow_table()
    frame: Any = pa.table(samples)
    times = frame["time"].cast(pa.timestamp("ns")).cast(pa.int64())
    return sorted(zip(frame["session"].to_pylist(), times.to_pylist(), strict=True))


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a dataset of two sessions, each with several parts of samples."""
    folder = tmp_path_factory.mktemp("readers")
    for name, start in (("first", 1_700_000_000_123_456_789), ("second", 1_700_000_100_000_000_001)):
        record(folder / "lab", [new_batch(Labelled, 50, start=start)], name)
    return folder


@pytest.mark.parametrize("number", range(3), ids=["polars", "pandas", "duckdb"])
def test_every_program_reads_all_sessions_with_their_names_and_timestamps(number: int, lab: Path) -> None:
    rows: list[tuple[str, int]] = []
    for name in ("first", "second"):
        session = Session.open(lab / "lab" / "sessions" / name)
        assert len(list((lab / "lab" / "sessions" / name / "samples").iterdir())) > 1
        for batch in session.read(Labelled, finger=0):
            rows += [(name, time) for time in batch.time.tolist()]
    assert read_as_on_the_page(number, lab) == rows


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_page_has_each_column_with_its_type_and_unit(name: str) -> None:
    rows = [(row["column"], row["type"], row["unit"]) for row in table(PAGE, f"### {name}")]
    assert rows == [(each.name, written(each.type), unit(each.metadata)) for each in SCHEMAS[name]]


def test_the_page_has_each_entry_of_a_span_labelled_by_hand() -> None:
    names: dict[Any, str] = {int: "integer", str: "string"}
    rows = [(row["entry"], row["type"]) for row in table(PAGE, "## Labels by hand")]
    assert rows == [(each.name, names[each.type]) for each in fields(LabelSpan)]


def test_no_column_may_be_null() -> None:
    assert not [field for each in SCHEMAS.values() for field in each if field.nullable]


def test_the_page_has_every_name_of_a_code() -> None:
    for each in TABLES:
        meanings = {row["column"]: row["meaning"] for row in table(PAGE, f"### {each.name}")}
        for name, column in each.columns.items():
            assert all(code in meanings[name] for code in column.names), name


def test_the_page_names_every_table_and_every_kind_of_fault() -> None:
    text = PAGE.read_text()
    assert {f"### {name}" for name in SCHEMAS} == set(re.findall(r"^### .*", text, re.MULTILINE))
    [kinds] = [row["meaning"] for row in table(PAGE, "### faults") if row["column"] == "kind"]
    assert kinds == ", ".join(f"{kind} {kind.name.lower()}" for kind in FaultKind)


def test_the_page_has_each_entry_of_the_descriptions(tmp_path: Path) -> None:
    session = record(tmp_path, [slip(1_700_000_000_000_000_000, 1)]).folder
    written: dict[str, Any] = json.loads((session / "session.json").read_text())
    rows = table(PAGE, "## dataset.json, session.json, MANIFEST.json")
    assert sorted(row["entry"] for row in rows) == sorted(written)
    text = PAGE.read_text()
    dataset = json.loads((session.parents[1] / "dataset.json").read_text())
    assert f"`{json.dumps(dataset)}`" in text
    manifest = json.loads((session / "MANIFEST.json").read_text())
    assert f"Its `version` is {manifest['version']}" in text
    for name in (*manifest, *manifest["parts"][0]):
        assert f"`{name}`" in text, name
