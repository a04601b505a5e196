"""`slipflow export` and `slipflow import` as a user meets them."""

import json
from pathlib import Path

import polars as pl
import pytest

from storage.layout import session_names
from tests.command import slipflow

TRACE = "t,p0,p1,p2,p3,p4,p5,slip\n" + "".join(
    f"{k / 100},{','.join(str(500 + (k + c) % 5) for c in range(6))},{k // 50 % 2}\n" for k in range(300)
)


def test_a_dataset_becomes_a_lerobot_dataset(tiny: Path, tmp_path: Path) -> None:
    done = slipflow("export", str(tiny), "out", "--to", "lerobot", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    frames = pl.read_parquet(tmp_path / "out" / "data" / "*" / "*.parquet")
    info = json.loads((tmp_path / "out" / "meta" / "info.json").read_text())
    assert found["frames"] == info["total_frames"] == len(frames)
    assert found["sessions"] == found["episodes"] == 12
    assert found["splits"] == info["splits"] == {"train": "0:9", "validation": "9:10", "test": "10:12"}
    assert {"observation.state", "observation.pose", "action"} < set(found["features"])


def test_a_dataset_becomes_a_file_for_each_session_or_one_session_one_file(
    tiny: Path, tmp_path: Path
) -> None:
    done = slipflow("export", str(tiny), "out", "--to", "mcap", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    names = session_names(tiny)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {f"{name}.mcap" for name in names}
    assert done.stdout.startswith("12 files, ")
    session = tiny / "sessions" / names[0]
    one = slipflow("export", str(session), "one.mcap", "--to", "mcap", "--json", cwd=tmp_path)
    assert list(json.loads(one.stdout)["files"]["one.mcap"]) == [
        "/touch/0",
        "/samples/0",
        "/episodes",
        "/motion",
    ]
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "out" / f"{names[0]}.mcap").read_bytes()


@pytest.mark.rerun
def test_a_session_becomes_a_rerun_recording_with_its_probability(tiny: Path, tmp_path: Path) -> None:
    session = tiny / "sessions" / session_names(tiny)[0]
    arguments = ("export", str(session), "one.rrd", "--to", "rrd", "--detector", "tcn", "--json")
    done = slipflow(*arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["files"]["one.rrd"]
    assert set(found) == {"/touch/0", "/probability/0", "/motion/speed", "/samples/0/speed"}
    assert 0 < found["/probability/0"] <= found["/touch/0"]


def test_a_trace_is_looked_at_then_imported_then_judged(tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text(TRACE)
    looked = slipflow("import", "lab.csv", "out", "--dry-run", cwd=tmp_path)
    assert looked.returncode == 0, looked.stderr
    assert "counts   p0 p1 p2 p3 p4 p5  (raw, guessed from the names)" in looked.stdout
    assert "labels of the file: 150 slip, 150 static" in looked.stdout
    assert "nothing written" in looked.stderr
    assert not (tmp_path / "out").exists()
    told = ("--map", "time=t,counts=p0..p5,label=slip", "--units", "time=s", "--rate", "100", "--finger", "2")
    done = slipflow("import", "lab.csv", "out", *told, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["written"], found["guessed"], found["finger"]) == (True, [], 2)
    samples = pl.read_parquet(tmp_path / "out/sessions/lab/samples/*.parquet")
    assert samples["label"].to_list() == [k // 50 % 2 for k in range(300)]
    judged = slipflow("evaluate", "out", "--split", "all", "--method", "psd", "--json", cwd=tmp_path)
    assert judged.returncode == 0, judged.stderr
    exported = slipflow("export", "out", "frames", "--to", "lerobot", cwd=tmp_path)
    assert exported.returncode == 0, exported.stderr
    assert "1 session, cut at 0 gaps: 1 episode (train 0:1)" in exported.stdout


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["import", "lab.csv", "out", "--map", "time"], "must be written as time=t,counts=p0..p5"),
        (["import", "lab.csv", "out", "--units", "time=h"], "unit of time is 'h', must be one of s, ms"),
        (["import", "lab.csv", "out", "--map", "label=p9"], "lab.csv, line 1: has the columns"),
        (["import", "lab.csv", "out", "--map", "label=p0"], "lab.csv, line 2, column p0: is '500', must be"),
        (["import", "lab.csv", "out", "--rate", "50"], "comes at 100.0 rows per second, not at 50"),
        (["import", "lab.csv", "out", "--delay", "soon"], "with its unit: 500ms"),
        (["import", "missing.csv", "out"], "missing.csv: cannot be read"),
        (["import", "lab.csv", "out", "--session", "../x"], "must be a file name"),
        (["export", "nowhere", "out", "--to", "lerobot"], "nowhere: there is no such folder"),
        (["export", "nowhere", "out", "--to", "rosbag"], "--to rosbag: give lerobot, mcap or rrd"),
        (["export", "nowhere", "out", "--to", "mcap", "--detector", "tcn"], "--detector is for --to rrd"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(arguments: list[str], why: str, tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text(TRACE)
    done = slipflow(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert why in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["lab.csv"]


def test_the_help_teaches(tmp_path: Path) -> None:
    exporting = " ".join(slipflow("export", "--help", cwd=tmp_path).stdout.split())
    assert "a session is an episode" in exporting
    assert "/touch/FINGER" in exporting
    importing = " ".join(slipflow("import", "--help", cwd=tmp_path).stdout.split())
    assert "time=t,counts=p0..p5,speed=v,label=slip" in importing
    assert "counts=left,right,top,bottom,tip,base" in importing.replace("- ", "-")
