"""Recipe `grasps`: slip in a grasp while the arm moves."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from connectors.files.column_map import ColumnMap
from flows.lab.recipes.dataset_recipe import DatasetRecipe, SourceRecording
from operators.errors import InputError

TAXELS: Final = ((1, 2, 5, 6), (3, 4), (7, 8), (9, 10, 13, 14), (11, 12), (15, 16))  # of each cell
BASELINE: Final = 10  # rows


def recordings(files: Mapping[str, Path]) -> Iterator[SourceRecording]:
    """Yield a recording of each trial, whose three files belong together row by row.

    Raises:
        InputError: if the files of a trial have different numbers of rows.
    """
    import numpy as np
    import polars as pl

    for folder in dict.fromkeys(path.rpartition("/")[0] for path in files):
        paths = [f"{folder}/{name}.csv" for name in ("robot_state", "slip_label", "xela_sensor1")]
        state, label, touch = (pl.read_csv(files[path]) for path in paths)
        for path, other in zip(paths[1:], (label, touch), strict=True):
            if len(other) != len(state):
                raise InputError(path, f"has {len(other)} rows, {paths[0]} has {len(state)}")
        cells = [
            touch.select(pl.mean_horizontal(f"txl{each}_z" for each in group)).to_series() for group in TAXELS
        ]
        means = np.column_stack([each.to_numpy() for each in cells])  # (n, 6)
        frame = pl.DataFrame(
            {
                "t": state["time"],  # s
                "b": np.round((means - means[:BASELINE].mean(axis=0)) / 4),
                "vx": state["v_x"],
                "vy": state["v_y"],
                "vz": np.zeros(len(state)),
                "slip": label["slip"],
            }
        )
        yield Path(folder).name.removeprefix("data_sample_"), frame, None


GRASPS: Final = DatasetRecipe(
    name="grasps",
    summary="Slip in a grasp while the arm moves (XELA uSkin on a Franka arm, 60 Hz, labels by a marker)\n  "
    "7 recordings, 1.88 MB\n  "
    "cite: Nazari, Mandil and Ghalamzan, Proactive slip control by learned slip model and trajectory"
    " adaptation, CoRL 2022, https://github.com/imanlab/proactive-slip-control",
    licence="MIT",
    about="Use, change and share it; keep the copyright notice.\n  "
    "A gripper with two 4x4 taxel pads moves a box along a line. A camera follows a marker on the box, "
    "which gives the label. Seven trials, 2,195 rows, 196 of them slip. The arm moves without slip most "
    "of the time: labels by the arm's speed would be wrong here.\n  "
    "Labels: slip of a marker on the box, by the authors.\n  "
    "Assumed: the six cells are our choice: means of the normal (z) values of two or four neighbouring "
    "taxels of pad 1, minus the first ten rows, divided by 4. Rows of the files of one trial belong "
    "together by their number. The arm moves in the xy plane: the source has no vertical velocity, the "
    "recipe gives 0.",
    repository="imanlab/proactive-slip-control",
    commit="73c84b02e382040ca4ab8de1b37d836b8f511d40",
    columns=ColumnMap.parse("time=t,counts=b0..b5,velocity=vx,vy,vz,label=slip,rate=60,zeroed=true"),
    registry=Path(__file__).with_suffix(".txt"),
    recordings=recordings,
)
