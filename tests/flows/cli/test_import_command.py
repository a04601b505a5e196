"""`slipflow import` in processes of its own."""

import json
from pathlib import Path

import polars as pl
import pytest

from tests.command import error, slipflow

TRACE = "t,p0,p1,p2,p3,p4,p5,slip\n" + "".join(
    f"{k / 100},{','.join(str(500 + (k + c) % 5) for c in range(6))},{k // 50 % 2}\n" for k in range(300)
)


def test_a_trace_is_checked_imported_evaluated_and_exported(tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text(TRACE)
    checked = slipflow("import", "lab.csv", "out", "--dry-run", cwd=tmp_path)
    assert checked.returncode == 0, checked.stderr
    assert "counts   p0 p1 p2 p3 p4 p5  (raw, recognised by name)" in checked.stdout
    assert "labels of the file: 150 slip, 150 static" in checked.stdout
    assert "dry run: nothing written" in checked.stderr
    assert not (tmp_path / "out").exists()
    columns = (
        "--map",
        "time=t,counts=p0..p5,label=slip",
        "--units",
        "time=s",
        "--rate",
        "100",
        "--finger",
        "2",
    )
    done = slipflow("import", "lab.csv", "out", *columns, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    [file] = found["files"]
    assert (found["written"], found["skipped"], file["recognised"], file["finger"]) == (1, 0, [], 2)
    samples = pl.read_parquet(tmp_path / "out/sessions/lab/samples/*.parquet")
    assert samples["label"].to_list() == [k // 50 % 2 for k in range(300)]
    judged = slipflow("evaluate", "out", "--split", "all", "--method", "paper_tcn", "--json", cwd=tmp_path)
    assert judged.returncode == 0, judged.stderr
    exported = slipflow("export", "out", "frames", "--to", "lerobot", cwd=tmp_path)
    assert exported.returncode == 0, exported.stderr
    assert "1 session, split at 0 gaps: 1 episode (train 0:1)" in exported.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["import", "lab.csv", "out", "--map", "time"], "must be written as time=t,counts=p0..p5"),
        (["import", "lab.csv", "out", "--units", "time=h"], "unit of time is 'h', must be one of s, ms"),
        (["import", "lab.csv", "out", "--map", "label=p9"], "lab.csv, line 1: has the columns"),
        (["import", "lab.csv", "out", "--map", "label=p0"], "lab.csv, line 2, column p0: is '500', must be"),
        (["import", "lab.csv", "out", "--rate", "50"], "has 100.0 rows per second, not 50"),
        (["import", "lab.csv", "out", "--delay", "soon"], "with its unit: 500ms"),
        (["import", "missing.csv", "out"], "missing.csv: cannot be read"),
        (["import", "lab.csv", "out", "--lever", "96"], "must be a length with its unit"),
        (["import", "lab.csv", "out", "--map", "joint=slip"], "lever is None, must be the distance"),
        (["import", "lab.csv", "out", "--labels", "slip"], "must be written as slip=1,2,static=0"),
        (["import", "lab.csv", "out", "--group", "("], "--group is '(', must be a regular expression"),
        (["import", "lab.csv", "out", "--group", "x"], "its name does not match --group 'x'"),
        (
            ["import", "lab.csv", "out", "--layout", "3x3"],
            "layout is '0,1,2/3,4,5/6,7,8', must be of 6 cells",
        ),
        (["import", "lab.csv", "out", "--range", "4000"], "range is '4000', must be LOW:HIGH"),
        (["import", "lab.csv", "out", "--separator", "none"], "separator is 'none', must be one of"),
        (["import", "lab.csv", "lab.csv", "out", "--session", "x"], "left out if there are several files"),
        (["import", "lab.csv", "lab.csv"], "OUT is 'lab.csv', must be a folder: the last argument is"),
        (["import", "lab.csv", "lab.csv", "out"], "has the same session name as lab.csv"),
        (["import", "lab.csv", "out", "--session", "../x"], "must be a file name"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(arguments: list[str], message: str, tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text(TRACE)
    assert message in error(*arguments, cwd=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["lab.csv"]


def test_rising_counts_with_a_stated_range_are_not_taken_for_falling_ones(tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text(TRACE)
    arguments = "import", "lab.csv", "out", "--layout", "3x2", "--range", "0:4000", "--raw"
    done = slipflow(*arguments, cwd=tmp_path)
    assert "  layout   0,1/2,3/4,5  (cells of each row, from the top)\n" in done.stdout
    assert "  range    0 to 4000  (readings rise as the pressure rises)\n" in done.stdout
    about = json.loads((tmp_path / "out/sessions/lab/session.json").read_text())
    tips = about["fingertips"]["samples"]
    assert (tips["layout"], tips["range"]) == ([[0, 1], [2, 3], [4, 5]], [0, 4000])
    refused = slipflow("evaluate", "out", "--split", "all", "--method", "tcn", "--json", cwd=tmp_path)
    assert refused.returncode == 2
    assert "Pool(gain=-1)" in refused.stderr
    assert not (tmp_path / "evaluation").exists()


def test_many_files_are_shown_as_a_table_and_imported_in_one_call(tmp_path: Path) -> None:
    for surface, rows in (("wood", 300), ("steel", 200)):
        lines = TRACE.splitlines(keepends=True)[: rows + 1]
        (tmp_path / f"{surface}_vel1.csv").write_text("".join(lines).replace(",", ";"))
    arguments = "import", "wood_vel1.csv", "steel_vel1.csv", "out", "--group", "(.+)_vel"
    shown = slipflow(*arguments, "--dry-run", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    assert [line.split() for line in shown.stdout.splitlines() if line.startswith("|")][2:] == [
        ["|", "wood_vel1.csv", "|", "wood", "|", "300", "|", "3.0", "|", "100.0", "|", "50.0", "|"],
        ["|", "steel_vel1.csv", "|", "steel", "|", "200", "|", "2.0", "|", "100.0", "|", "50.0", "|"],
    ]
    assert "groups: wood 1, steel 1\n2 sessions of out\n" in shown.stdout
    assert not (tmp_path / "out").exists()
    done = slipflow(*arguments, "--json", cwd=tmp_path)
    assert json.loads(done.stdout)["written"] == 2
    about = json.loads((tmp_path / "out/sessions/steel_vel1/session.json").read_text())
    assert about["group"] == "steel"
    assert "--skip-existing leaves it out" in error(*arguments, cwd=tmp_path)
    again = slipflow(*arguments, "--skip-existing", "--json", cwd=tmp_path)
    assert (json.loads(again.stdout)["written"], json.loads(again.stdout)["skipped"]) == (0, 2)


def test_one_bad_file_of_many_is_named_and_nothing_is_written(tmp_path: Path) -> None:
    (tmp_path / "good.csv").write_text(TRACE)
    (tmp_path / "bad.csv").write_text(TRACE.replace("0.5,", "soon,"))
    done = slipflow("import", "good.csv", "bad.csv", "out", cwd=tmp_path)
    assert done.returncode == 2
    assert "error: bad.csv, line 52, column t: is 'soon', must be a time in s" in done.stdout
    assert "error: 1 of 2 files cannot be imported, so nothing was written" in done.stderr
    assert not (tmp_path / "out").exists()
