"""`slipflow import` in processes of its own."""

import json
from pathlib import Path

from tests.command import slipflow, succeed

TRACE = "t,p0,p1,p2,p3,p4,p5,slip\n" + "".join(
    f"{k / 100},{','.join(str(500 + (k + c) % 5) for c in range(6))},{k // 50 % 2}\n" for k in range(300)
)


def test_rising_counts_with_a_stated_range_are_not_taken_for_falling_ones(tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text(TRACE)
    arguments = "import", "lab.csv", "out", "--map", "layout=3x2,range=0:4000,zeroed=false"
    done = slipflow(*arguments, cwd=tmp_path)
    assert "  layout   0,1/2,3/4,5  (cells of each row, from the top)\n" in done.stdout
    assert "  range    0 to 4000  (readings rise as the pressure rises)\n" in done.stdout
    about = json.loads((tmp_path / "out/sessions/lab/session.json").read_text())
    tips = about["fingertips"]["samples"]
    assert (tips["layout"], tips["range"]) == ([[0, 1], [2, 3], [4, 5]], [0, 4000])
    refused = slipflow("evaluate", "out", "--split", "all", "--method", "tcn", cwd=tmp_path)
    assert refused.returncode == 2
    assert "Pool(gain=-1)" in refused.stderr
    assert not (tmp_path / "evaluation").exists()


def test_many_files_are_imported_in_one_call_that_can_be_repeated(tmp_path: Path) -> None:
    for surface, rows in (("wood", 300), ("steel", 200)):
        lines = TRACE.splitlines(keepends=True)[: rows + 1]
        (tmp_path / f"{surface}_vel1.csv").write_text("".join(lines).replace(",", ";"))
    (tmp_path / "bad_vel1.csv").write_text(TRACE.replace("0.5,", "soon,"))
    arguments = "import", "wood_vel1.csv", "bad_vel1.csv", "steel_vel1.csv", "out", "--group", "(.+)_vel"
    done = slipflow(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "error: bad_vel1.csv, line 52, column t: is 'soon', must be a time in s" in done.stdout
    assert "error: 1 of 3 files cannot be imported: repair and repeat" in done.stderr
    about = json.loads((tmp_path / "out/sessions/steel_vel1/session.json").read_text())
    assert about["group"] == "steel"
    (tmp_path / "bad_vel1.csv").write_text(TRACE)
    again = succeed(*arguments, cwd=tmp_path)
    left_out = "left out, the dataset has it; to replace it, delete out/sessions/"
    assert again.stdout.startswith(f"wood_vel1: {left_out}wood_vel1\nbad_vel1.csv: 300 rows")
    assert again.stdout.endswith(f"steel_vel1: {left_out}steel_vel1\n")
    changed = succeed(*arguments, "--map", "layout=3x2", "--dry-run", cwd=tmp_path)
    assert changed.stdout.count(left_out) == 3
    assert "  layout   0,1/2,3/4,5  (cells of each row, from the top)\n" in changed.stdout
    (tmp_path / "seven.csv").write_text(TRACE.replace("slip", "p6"))
    mixed = slipflow("import", "seven.csv", "wood_vel1.csv", "out", "--map", "layout=3x2", cwd=tmp_path)
    assert "error: seven.csv: Trace: layout is '0,1/2,3/4,5', must be of 7 cells" in mixed.stdout
    assert "error: 1 of 2 files cannot be imported" in mixed.stderr
    assert "out: is a folder: give out/*.csv" in slipflow("import", "out", "lab", cwd=tmp_path).stderr
