"""`slipflow import` in processes of its own."""

import json
import threading
from pathlib import Path

import numpy as np
import polars as pl

from tests.command import slipflow

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
    refused = slipflow("evaluate", "out", "--split", "all", "--method", "tcn", "--json", cwd=tmp_path)
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
    again = slipflow(*arguments, "--json", cwd=tmp_path)
    states = [each["state"] for each in json.loads(again.stdout)["files"]]
    assert states == ["present", "written", "present"]
    assert "2 sessions left out: the dataset has them already" in again.stderr


def test_a_user_gets_from_an_own_file_to_live_alerts_by_the_commands_that_are_printed(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    time = np.arange(0, 40, 0.005)  # s
    slips = time % 8 > 5
    readings = (
        101.3 + (time % 8 > 2)[:, None] * random.uniform(3, 8, 16) + random.normal(0, 0.02, (len(time), 16))
    )
    readings += slips[:, None] * random.normal(0, 1.2, readings.shape)
    cells = {f"taxel_{k // 4}_{k % 4} [kPa]": readings[:, k].round(2) for k in range(16)}
    words = np.where(slips, "rutscht", "haftet")
    frame = pl.DataFrame({"Zeit [s]": time.round(3), **cells, "Zustand": words})
    frame.write_csv(tmp_path / "bench.csv", separator=";", decimal_comma=True)

    def following(*command: str) -> str:
        """Run a command; return the next one, which it prints at its end."""
        done = slipflow(*command, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        return done.stderr.rpartition("next: slipflow ")[2].strip()

    second = following("import", "bench.csv", "own", "--dry-run")
    assert second == "import bench.csv own --flow own.py"
    assert following(*second.split()) == "show own/sessions/bench"  # which prints the next one at Ctrl-C
    last = following("train", "own", "-o", "own.safetensors", "--steps", "6", "--filters", "4")
    assert last == "run own.py"
    lines, ended = (tmp_path / "bench.csv").read_text().splitlines()[1:], threading.Event()

    def log() -> None:
        """Append rows as a logger does."""
        with (tmp_path / "bench.csv").open("a") as file:
            for number, line in enumerate(lines):
                file.write(f"{40 + number / 200:.3f};".replace(".", ",") + line.partition(";")[2] + "\n")
                file.flush()
                if ended.wait(0.01):
                    return

    logger = threading.Thread(target=log)
    logger.start()
    live = slipflow("run", "own.py", "--for", "3s", "--json", cwd=tmp_path)
    ended.set()
    logger.join()
    found = json.loads(live.stdout)
    assert (found["error"], found["sources"]["touch"]["rows"] > 50) == (None, True), live.stderr
