"""Results of "Under Pressure" (2021) for comparison: Tables I and III, of real recordings."""

from collections.abc import Mapping
from typing import Final

SURFACES: Final = ("plane", "sphere", "cylinder_y", "cylinder_x")

TABLE_1: Final[Mapping[str, float]] = {
    "PSD threshold": 57.4,
    "frequency CNN": 86.0,
    "TCN": 91.3,
}  # accuracy, %
PAPER_ROWS: Final[Mapping[str, str]] = {  # row of Table I that a method is compared with
    "psd": "PSD threshold",
    "psd_1s": "PSD threshold",
    "frequency_cnn": "frequency CNN",
    "paper_tcn": "TCN",
    "tcn": "TCN",
}

# F1, %, on each of `SURFACES` and on all of them; by motion and speed, m/s
TABLE_3: Final[Mapping[tuple[str, float | None], tuple[float, ...]]] = {
    ("primary", 0.05): (92.5, 88.8, 78.7, 94.0, 89.7),
    ("primary", 0.075): (94.9, 88.0, 90.0, 90.3, 91.6),
    ("primary", 0.1): (95.7, 84.5, 87.8, 92.1, 93.1),
    ("oblique", 0.05): (94.0, 88.9, 87.1, 93.2, 91.5),
    ("oblique", 0.075): (96.6, 89.3, 93.7, 92.2, 93.1),
    ("oblique", 0.1): (96.4, 88.6, 93.5, 93.4, 93.8),
    ("rotation", None): (84.6, 74.5, 84.0, 86.1, 81.5),
}

TABLE_3_ANY: Final = (94.0, 88.9, 88.0, 91.9)  # F1, %, of any motion on each of `SURFACES`
