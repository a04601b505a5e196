"""Files in the formats of the two datasets with a recipe, made of columns."""

from collections.abc import Mapping
from typing import Final

import numpy as np
import polars as pl

BEGIN: Final = 1508406493195955843  # ns since 1970

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
    columns |= {f"field.el{number - 1}": frame[f"e{number}"] for number in range(1, 20)}
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


def _csv(columns: Mapping[str, object]) -> bytes:
    return pl.DataFrame(columns).write_csv().encode()
