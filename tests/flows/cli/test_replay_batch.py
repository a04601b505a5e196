"""Replays of several recordings in processes of their own: output and exit codes."""

import os
import re
import signal
import subprocess
from pathlib import Path
from shutil import copytree

from tests.command import SLIPFLOW, captured, slipflow, succeed
from tests.storage.made import contents, session_names
from tests.waiting import PATIENCE, wait_until

WRONG = """
from connectors import Console, SimulatedRig
from flows.graph import Flow
from operators import Debounce

def wrong() -> Flow:
    flow = Flow("wrong")
    (flow.source(SimulatedRig().touch) | Debounce()).to(Console())
    return flow
"""


def test_each_replay_has_a_summary_and_a_failed_one_an_error(tiny: Path, tmp_path: Path) -> None:
    dataset = copytree(tiny, tmp_path / "dataset")
    first, second, third = [dataset / "sessions" / name for name in session_names(dataset)[:3]]
    (second / "touch/part-000000.parquet").unlink()
    done = slipflow("run", "live", "--set", "detector=psd", "--replay", first, second, third, "--jobs", "1")
    assert done.returncode == 1
    assert f"error: {second}: " in done.stderr
    *one, last = (line for line in done.stdout.splitlines() if not line.startswith("  "))
    for path, line in zip((first, third), one, strict=True):
        assert re.match(rf"{path} -> {path.name}: [\d.]+ s, [\d,]+ touch; \d+ to console$", line)
    assert re.fullmatch(r"3 recordings, [\d,]+ rows in [\d.]+ s; 1 failed", last)


def test_what_a_flow_file_prints_is_printed_once(tiny: Path, tmp_path: Path) -> None:
    flow = tmp_path / "loud.py"
    flow.write_text(WRONG.replace("Debounce", "Health") + "print('loaded')\n")
    found = tiny / "sessions" / session_names(tiny)[0]
    done = slipflow("run", flow, "--replay", tmp_path / "gone", found, "--jobs", "2")
    assert done.returncode == 1
    assert done.stdout.startswith("loaded\n")
    assert done.stdout.count("loaded") == 1
    assert f"error: {tmp_path / 'gone'}: there is no such file or folder" in done.stderr
    assert done.stdout.splitlines()[-1].startswith("2 recordings, ")


def test_what_a_part_printed_before_its_failure_is_printed(tiny: Path, tmp_path: Path) -> None:
    flow, found = tmp_path / "loud.py", tiny / "sessions" / session_names(tiny)[0]
    own = """
from operators import Faults, Operator, Touch
class Check(Operator[Touch, Faults]):
    def process(self, batch: Touch) -> Faults:
        print("first row", batch.time[0])
        return 1 / 0
"""
    flow.write_text(own + WRONG.replace("Debounce()", "Check()"))
    done = slipflow("run", flow, "--replay", found)
    assert re.fullmatch(r"first row \d+\n", done.stdout)
    assert done.stderr.endswith("loud.py:6)\n")


def test_a_dataset_is_compiled_for_once_and_each_recording_has_its_error(tiny: Path, tmp_path: Path) -> None:
    two, flow = [tiny / "sessions" / name for name in session_names(tiny)[:2]], tmp_path / "own.py"
    errors = list[str]()
    for operator in ("Pool(((0,), (9,)))", "Pool(gain=0.5)"):
        text = WRONG.replace("Console()", f"Dataset('{tmp_path}/out')").replace("Debounce()", operator)
        flow.write_text(text.replace("Debounce", "Pool") + "\nfrom storage import Dataset\n")
        command = [*SLIPFLOW, "run", str(flow), "--replay", *map(str, two), "--jobs", "2"]
        env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
        errors += [captured(*command, env=env).stderr]
    assert all(re.search(f"error: {each}: .*Pool needs 10 cells", errors[0]) for each in two)
    assert errors[1].count("compiling for this machine") == 1


def test_recording_into_the_replayed_dataset_is_an_error(tiny: Path, tmp_path: Path) -> None:
    dataset = copytree(tiny, tmp_path / "dataset")
    before = session_names(dataset)
    for paths in ([dataset], [dataset / "sessions" / before[0]]):
        done = slipflow("run", "record", "--set", f"out={dataset}", "--replay", *paths)
        assert done.returncode == 2
        assert "is in the dataset that the flow records into" in done.stderr
    assert session_names(dataset) == before


def test_after_ctrl_c_the_same_command_continues(tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    five = [str(tiny / "sessions" / name) for name in session_names(tiny)[:5]]
    arguments = ["run", "record", "--replay", *five]
    resumed = [*arguments, "--set", f"out={out}", "--jobs", "2"]
    with subprocess.Popen(
        [*SLIPFLOW, *resumed],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        wait_until(lambda: any(out.glob("sessions/*")), process)  # one is complete
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to all of them
        _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert errors.splitlines()[-1] == "interrupted: repeat the command to continue with the missing sessions"
    assert sorted(path.name for path in out.iterdir()) == ["dataset.json", "sessions"]
    kept = session_names(out)
    assert 0 < len(kept) < 5
    done = succeed(*resumed)
    assert f"{len(kept)} recording{'s' * (len(kept) > 1)} of 5 replayed already" in done.stderr
    succeed(*arguments, "--set", f"out={tmp_path / 'whole'}", "--jobs", "1")
    assert contents(out) == contents(tmp_path / "whole")
