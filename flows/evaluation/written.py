"""A page and its numbers as files."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from flows.evaluation.page import Page, Section
from flows.figures import save
from operators.errors import EndpointError


def claim(folder: Path) -> None:
    """Make sure that there is a folder to write to, before anything is measured.

    Raises:
        EndpointError: if there cannot be one.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EndpointError(str(folder), f"cannot be made: {error.strerror}") from error


def written(page: Page, numbers: Mapping[str, Any], folder: Path, name: str) -> list[Path]:
    """Write ``NAME.html``, ``NAME.md``, ``NAME.json`` and each section's figure into a folder; their paths.

    Raises:
        EndpointError: if they cannot be written.
    """
    claim(folder)
    texts = {"html": page.html(), "md": page.markdown(name), "json": json.dumps(numbers, indent=1) + "\n"}
    paths = [folder / f"{name}.{ending}" for ending in texts]
    try:
        for path, text in zip(paths, texts.values(), strict=True):
            path.write_text(text, encoding="utf-8")
        for section in page.sections:
            if section.figure is not None:
                paths.append(folder / section.file(name))
                save(section.figure, paths[-1])
    except OSError as error:
        raise EndpointError(str(folder), f"cannot be written: {error.strerror}") from error
    return paths


def told(sections: Sequence[Section]) -> str:
    """Titles and tables, for a terminal."""
    return "\n\n".join(
        part
        for section in sections
        for part in (section.title, *(table.markdown() for table in section.tables))
    )
