"""Recipe `strokes`: a finger strokes six surfaces."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from connectors.files.column_map import ColumnMap
from flows.lab.recipes.dataset_recipe import DatasetRecipe, SourceRecording

LEVER: Final = 0.096  # m, from joint FFJ4 to the fingertip
SLIP: Final = 0.005  # m/s
PAIRS: Final = ((0, 1), (2, 3), (4, 5), (10, 11), (12, 13), (14, 15))  # neighbouring electrodes of the flanks

_STAMP: Final = "field.header.stamp"  # ns since 1970
_JOINT: Final = "field.FFJ4_process_value_dot"  # rad/s


def recordings(files: Mapping[str, Path]) -> Iterator[SourceRecording]:
    """Yield a recording of each file."""
    import numpy as np
    import polars as pl

    electrodes = [f"field.el{each}" for pair in PAIRS for each in pair]
    for path, file in files.items():
        source = pl.read_csv(file, infer_schema=False, truncate_ragged_lines=True)
        texts = source.select(pl.col(_STAMP, _JOINT, *electrodes).str.strip_chars())
        numbers = (
            pl.col(_STAMP).cast(pl.Int64, strict=False),
            pl.exclude(_STAMP).cast(pl.Float64, strict=False),
        )
        valid = texts.with_columns(*numbers).drop_nulls().drop_nans()
        means = valid.select(electrodes).to_numpy().reshape(len(valid), len(PAIRS), 2).mean(axis=2)  # (n, 6)
        speed = valid[_JOINT].abs() * LEVER
        frame = pl.DataFrame(
            {
                "time_ns": valid[_STAMP],
                "b": np.round(means - np.median(means, axis=0)),
                "speed": speed,
                "label": speed > SLIP,
            }
        )
        name = Path(path).stem
        yield name, frame, name.partition("_vel")[0]


STROKES: Final = DatasetRecipe(
    name="strokes",
    summary="A finger strokes six surfaces (BioTac on a Shadow hand, 100 Hz, joint speed)\n  "
    "47 recordings, 122 MB\n  "
    "cite: nomadik, vibrotexturerecog (recordings of 2017), https://github.com/nomadik/vibrotexturerecog",
    licence="none",
    about="The repository states no licence, so all rights remain with its authors: download it for your own "
    "study; ask them before you share the data or anything that contains it.\n  "
    "A finger strokes a surface back and forth at 14 to 115 mm/s and rests 1 to 6 s in contact between "
    "strokes. 47 recordings of six surfaces; the name is surface_velN[_again]. dvp_flat and dvp_back are "
    "the two sides of a wooden board, still is steel, fabric and tkan are fabrics, oboi is wallpaper. "
    "Three files of the source are empty, and its folder calibration has no strokes: both are left out.\n  "
    "Labels: slip where the joint's speed times 0.096 m is above 5 mm/s.\n  "
    "Assumed: the speed is that of joint FFJ4 times a lever of 0.096 m, which was estimated, not "
    "measured. The six cells are our choice: means of two neighbouring electrodes on the flanks of the "
    "fingertip, minus the median of the recording, which includes strokes. The range is that of the sensor's "
    "converter, 12 bits, which falls as an electrode is pressed. Rows with a value that is not "
    "a number are left out. The label follows the joint; touch leads it by about 50 ms. The meaning of "
    "the surfaces' names was translated from Russian, not stated by the source.",
    repository="nomadik/vibrotexturerecog",
    commit="e24c837c33b5689b04cd4210dcb5d5a88ada24ee",
    columns=ColumnMap.parse(
        "time=time_ns,counts=b0..b5,speed=speed,label=label,rate=100,zeroed=true,range=4095:0"
    ),
    registry=Path(__file__).with_suffix(".txt"),
    recordings=recordings,
)
