"""The folder deploy/, and what its small install omits."""

from pathlib import Path
from typing import Final

DEPLOY: Final = Path(__file__).parents[2] / "deploy"
PAGE: Final = (DEPLOY.parent / "docs" / "how-to" / "deploy.md").read_text()
LEFT_OUT: Final = {"numba", "polars", "scipy"}
