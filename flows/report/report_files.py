"""Writing a page of findings: HTML, Markdown, its numbers as JSON, and its figures."""

import json
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from flows.report.figures import save
from flows.report.page import Page
from operators.errors import EndpointError, os_error_reason


def make_output_folder(folder: Path) -> None:
    """Make the folder that results will be written to; call it before a long measurement.

    Raises:
        EndpointError: if it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EndpointError(str(folder), f"cannot be made: {os_error_reason(error)}") from error


@contextmanager
def writing(folder: Path) -> Generator[None]:
    """What is within it writes into a folder.

    Raises:
        EndpointError: if that fails.
    """
    try:
        yield
    except OSError as error:
        raise EndpointError(str(folder), f"cannot be written: {os_error_reason(error)}") from error


def write_page(page: Page, numbers: Mapping[str, Any], folder: Path, name: str) -> list[Path]:
    """Write ``NAME.html``, ``NAME.md``, ``NAME.json`` and each section's figure into a folder; their paths.

    Raises:
        EndpointError: if they cannot be written.
    """
    make_output_folder(folder)
    texts = {"html": page.html(), "md": page.markdown(name), "json": json.dumps(numbers, indent=1) + "\n"}
    paths = [folder / f"{name}.{ending}" for ending in texts]
    with writing(folder):
        for path, text in zip(paths, texts.values(), strict=True):
            path.write_text(text, encoding="utf-8")
        for section in page.sections:
            if section.figure is not None:
                paths.append(folder / section.file(name))
                save(section.figure, paths[-1])
    return paths
