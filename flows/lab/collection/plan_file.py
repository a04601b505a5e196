"""Collection plans as TOML files; `plans/` holds those that ship with the package."""

from pathlib import Path
from typing import Final

from flows.lab.collection.stroke_plan import CollectionPlan
from flows.lab.toml_file import parse_dataclass, shipped_text

SHIPPED: Final = {path.stem: path for path in sorted((Path(__file__).parent / "plans").glob("*.toml"))}


def plan_text(plan: str) -> tuple[Path, str]:
    """Return the path and the text of a plan: the name of a shipped one, or a TOML file.

    Raises:
        ParameterError: if there is no shipped plan of that name.
        InputError: if the file cannot be read.
    """
    return shipped_text("collect", "plan", plan, SHIPPED)


def load_plan(plan: str) -> CollectionPlan:
    """Return a plan: the name of a shipped one, or a TOML file.

    >>> load_plan("tiny").speeds
    (0.05,)

    Raises:
        ParameterError: if there is no shipped plan of that name, or a key has an invalid value.
        InputError: if the file cannot be read, is not TOML, or has an unknown key.
    """
    path, text = plan_text(plan)
    return parse_dataclass(CollectionPlan, path, text)
