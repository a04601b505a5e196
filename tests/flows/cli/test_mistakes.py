"""A mistake on the command line is one line that says what to do, with exit code 2; nothing is written."""

import importlib.util
from pathlib import Path

import pytest

from tests.command import slipflow
from tests.flows.cli.test_import_command import TRACE

NEEDS_UR = pytest.mark.skipif(importlib.util.find_spec("rtde_control") is None, reason="needs the extra `ur`")
FILES = {
    "lab.csv": TRACE,
    "wrong.csv": "a,b\n1,2\n",
    "broken.py": "def broken(:\n",
    "both.toml": "[[surfaces]]\n[[surfaces]]\npose = [1, 0, 0, 3, 0, 0]",
}
MISTAKES = [
    # usage
    ("run live --fr 5s", "no such option: --fr. Did you mean --for? See slipflow run --help"),
    ("run live --debug", "--debug stands before the command: slipflow --debug COMMAND"),
    ("run", "missing argument 'FILE[:FLOW]'. See slipflow run --help"),
    ("rum live", "no such command 'rum'. Did you mean 'run'? See slipflow --help"),
    ("simulate out --seed x", "invalid value for '--seed': must be a valid integer. See slipflow simulate"),
    # run and check
    ("run broken.py", "broken.py:1: invalid syntax"),
    ("run live --replay missing.csv", "missing.csv"),
    ("run live --replay wrong.csv", "wrong.csv"),
    ("run record --set out=lab.csv --for 1s", "lab.csv"),
    ("run live --page --listen 0.0.0.0:0", "Page: host is '0.0.0.0', must be 127.0.0.1, or set SLIPFLOW_"),
    ("run live --for soon", "run: --for is 'soon', must be a time with its unit: 500ms, 30s, 1h or 30d"),
    ("run live --jobs 2", "--jobs is for replays: add --replay PATH"),
    ("run live x.csv", "a further recording is for replays: add --replay PATH"),
    ("run live --replay x.csv --page", "--page is for live runs: omit it (slipflow show shows a recording)"),
    ("run live --replay . --cluster tcp://x:1 --jobs 2", "workers: jobs is 2, must be omitted with a cluste"),
    ("run live --set detector", "--set detector: write it as NAME=VALUE, such as seed=1"),
    ("run live --listen host:", "--listen host:: write it as PORT or HOST:PORT, such as 8765"),
    ("run live --metrics 0.0.0.0:9464", "Metrics: host is '0.0.0.0', must be 127.0.0.1, or set SLIPFLOW_"),
    ("check live --set detector=oracle", "oracle: is not a detector: give "),
    ("check live --set seeds=1", "live: has no parameter 'seeds'; it has detector"),
    ("check record --set delay=-1ms", "record: delay is -1000000, must be at least 0 ns"),
    ("doctor --set a=1", "--set requires a flow"),
    ("show .", ": is not a session"),
    ("show none --listen 0.0.0.0:0", "Page: host is '0.0.0.0', must be 127.0.0.1"),  # none is not read
    ("watch mqtt://127.0.0.1:1", "mqtt://127.0.0.1:1: cannot connect"),
    ("watch localhost", "localhost"),
    ("watch --since yesterday", "yesterday"),
    # detectors and experiments
    ("calibrate tcn --on TINY --false-alarms 2", "must be a rate with its unit: 1/min or 6/h"),
    ("calibrate tcn --on TINY --false-alarms 0/min", "must be above 0"),
    ("calibrate tcn --on TINY --confidence 0.95", "must be a share with its unit: 95%"),
    ("calibrate tcn --on TINY --confidence 50%", "must be from 0.8 to 0.999"),
    ("evaluate nowhere", "there is no such folder"),
    ("evaluate TINY --train", "needs --hold-out"),
    ("evaluate", "needs a dataset, or --stress without one"),
    ("evaluate TINY --hold-out all --split validation", "judges groups of all splits: omit --split"),
    ("train TINY --method lstm", "--method is 'lstm', must be one of tcn, frequency_cnn, paper_tcn"),
    ("train TINY --from m.safetensors -o ./m.safetensors", "must be another file than that of --from"),
    ("evaluate --stress --chart", "omit --split, --hold-out and --chart"),
    ("evaluate TINY --method oracle", "oracle: is not a method"),
    ("evaluate nowhere --method missing.safetensors", "missing.safetensors: cannot be read"),
    ("experiment tap --object egg", "object is 'egg', must be one of box"),
    ("experiment tap --method psd:best", "rule is 'best', must be one of ours, steps, none"),
    # data
    ("collect tiny", "--robot HOST"),
    ("collect both.toml --virtual", "has several surfaces; the virtual arm has one"),
    pytest.param("collect tiny --robot 127.0.0.1 --rows a", "must be row numbers", marks=NEEDS_UR),
    pytest.param("collect tiny --robot 127.0.0.1:x", "rtde://", marks=NEEDS_UR),
    ("export nowhere out --to rosbag", "--to rosbag: give lerobot or mcap"),
    ("export nowhere out --to mcap --rate 5", "--rate requires --to lerobot"),
    ("fetch stroke out", "NAME is 'stroke', must be one of grasps, strokes"),
    ("fetch grasps", "OUT is None, must be the folder of the new dataset"),
    ("import lab.csv out --map label=p0", "lab.csv, line 2, column p0: has '500', '501'"),
    ("import lab.csv out --map @none.map", "none.map: cannot be read: No such file"),
    ("import lab.csv out --group (", "--group is '(', must be a regular expression"),
    ("import lab.csv out --group x", "its name does not match --group 'x'"),
    ("import lab.csv lab.csv", "OUT is 'lab.csv', must be a folder: the last argument is"),
    ("import lab.csv lab.csv out", "has the same session name as lab.csv"),
    ("simulate out --plan papre", "plan is 'papre', must be one of paper, wide, slow, calm, tiny"),
]


@pytest.mark.parametrize(("words", "text"), MISTAKES)
def test_a_mistake_is_one_line_and_exit_code_2(words: str, text: str, tiny: Path, tmp_path: Path) -> None:
    for name, content in FILES.items():
        (tmp_path / name).write_text(content)
    done = slipflow(*words.replace("TINY", str(tiny)).split(), cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, ""), done
    assert "Traceback" not in done.stderr
    *progress, line = done.stderr.splitlines()
    reports = words.startswith(("calibrate", "collect", "evaluate", "show"))
    assert reports or all(" INFO " in each for each in progress)
    assert line.startswith("error: ")
    assert text in line
    assert {path.name for path in tmp_path.iterdir()} - {"state", "recordings"} == FILES.keys()
