"""Files in the formats of the three datasets with a recipe, made of columns, and recipes for them."""

from collections.abc import Mapping
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl

from flows.lab.recipes.dataset_recipe import DatasetRecipe, SourceFile, SourceRecording, load_recipe
from operators.batch import Reals

ELECTRODES: Final = range(1, 20)
PAIRS: Final = ((1, 2), (3, 4), (5, 6), (11, 12), (13, 14), (15, 16))
GROUPS: Final = ((1, 2, 5, 6), (3, 4), (7, 8), (9, 10, 13, 14), (11, 12), (15, 16))  # taxels
BEGIN: Final = 1508406493195955843  # ns since 1970
LEVER: Final = 0.096  # m

_FINGERS: Final = ("", "M")  # first finger, middle finger
_JOINT: Final = (*("set_point", "position_gain", "process_value", "process_value_dot", "error", "command"),)


def strokes_header() -> list[str]:
    """Return the columns of a file of the strokes, in their order."""
    joints = [
        f"FF{kind}{joint}{end}"
        for end, kind in (("", "J"), ("_dot", "J"), ("_tao", "J"))
        for joint in range(1, 5)
    ]
    names = ["header.seq", "header.stamp", "header.frame_id", *(f"FFJ4_{each}" for each in _JOINT), *joints]
    names += ["pac0", "pac1", "pdc0", "tac0", "tdc0", *(f"el{number}" for number in range(19))]
    names += ["dt", "time", "test_time2"]
    names += [f"FFJ{joint}_{each}" for joint in (0, 3) for each in _JOINT]
    names += [each.replace("FF", "MF") for each in joints]
    names += ["Mpac0", "Mpac1", "Mpdc0", "Mtac0", "Mtdc0", *(f"Mel{number}" for number in range(19))]
    return ["%time", *(f"field.{name}" for name in names)]


def strokes_csv(frame: pl.DataFrame) -> bytes:
    """Return a source file of the columns t (s), w (rad/s), e1 to e19."""
    rows = len(frame)
    stamps = BEGIN + np.rint(frame["t"].to_numpy() * 1e9).astype(np.int64)
    columns: dict[str, object] = dict.fromkeys(strokes_header(), np.zeros(rows))
    columns |= {"%time": stamps + 534867, "field.header.stamp": stamps}
    columns |= {"field.header.frame_id": ["plot_matl"] * rows, "field.FFJ4_process_value_dot": frame["w"]}
    columns |= {f"field.el{number - 1}": frame[f"e{number}"] for number in ELECTRODES}
    return _csv(columns)


def grasps_csv(frame: pl.DataFrame) -> dict[str, bytes]:
    """Return the source files of a trial with the columns t, vx, vy, label, s1_txl1_x to s1_txl16_z."""
    state = {f"position_joint{joint}": np.zeros(len(frame)) for joint in range(1, 8)}
    taxels = [f"txl{number}_{axis}" for number in range(1, 17) for axis in "xyz"]
    return {
        "robot_state.csv": _csv({**state, "v_x": frame["vx"], "v_y": frame["vy"], "time": frame["t"]}),
        "slip_label.csv": _csv({"slip": frame["label"].cast(pl.Float64), "fail": np.zeros(len(frame))}),
        "xela_sensor1.csv": _csv({name: frame[f"s1_{name}"] for name in taxels}),
    }


def barometers_csv(frame: pl.DataFrame) -> bytes:
    """Return a source file of the columns Sensor_0 to Sensor_3, x, z, time."""
    return _csv(
        {name: frame[name] for name in ("Sensor_0", "Sensor_1", "Sensor_2", "Sensor_3", "x", "z", "time")}
    )


def copy_of(name: str, recordings: Mapping[str, Mapping[str, bytes]], folder: Path) -> DatasetRecipe:
    """Write the files of some recordings of a shipped recipe; return the recipe with their checksums.

    Args:
        name: Name of the recipe.
        recordings: Content of the files by file name, by recording.
        folder: Folder like a clone of the source.
    """
    recipe, found = load_recipe(name), list[SourceRecording]()
    for recording in recipe.recordings:
        if recording.name in recordings:
            files = list[SourceFile]()
            for file in recording.files:
                data = recordings[recording.name][file.name]
                path = folder / file.path
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)
                files.append(SourceFile(file.path, len(data), sha256(data).hexdigest()))
            found.append(replace(recording, files=tuple(files)))
    assert len(found) == len(recordings)
    return replace(recipe, recordings=tuple(found))


def strokes_frame(rows: int, seed: int) -> pl.DataFrame:
    """Return drawn columns for `strokes_csv`."""
    generator = np.random.default_rng(seed)
    electrodes = generator.integers(2000, 3500, (rows, 19)).astype(np.int16)
    speed = np.where(np.arange(rows) // 50 % 2, 0.4, 0.01) + generator.normal(0, 0.003, rows)  # rad/s
    columns: dict[str, object] = {f"e{number}": electrodes[:, number - 1] for number in ELECTRODES}
    jitter = np.sort(generator.uniform(-0.0003, 0.0003, rows))
    columns |= {"t": np.round(np.arange(rows) / 100 + jitter - jitter[0], 9), "w": speed}
    return pl.DataFrame(columns)


def expected_strokes(frame: pl.DataFrame) -> tuple[Reals, Reals, Reals]:
    """Return counts (n, 6), speed (n,) in m/s and label (n,) of the columns of a file of the strokes."""
    values = [[frame[f"e{number}"].cast(pl.Float64).to_numpy() for number in pair] for pair in PAIRS]
    pairs: Reals = np.mean(values, axis=1).T  # (n, 6)
    speed = np.abs(frame["w"].cast(pl.Float64).to_numpy()) * LEVER
    return np.round(pairs - np.median(pairs, axis=0)), speed, (speed > 0.005).astype(float)


def _csv(columns: Mapping[str, object]) -> bytes:
    return pl.DataFrame(columns).write_csv().encode()
