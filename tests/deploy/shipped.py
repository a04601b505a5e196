"""The folder deploy/, and what its small install omits."""

from pathlib import Path
from typing import Final

DEPLOY: Final = Path(__file__).parents[2] / "deploy"
LEFT_OUT: Final = {"numba", "polars", "scipy"}
