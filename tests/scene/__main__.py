"""Measure the simulated scene: `make scene`, or `python -m tests.scene --help`."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

from flows.lab.simulation import PLANS
from flows.report.figures import require
from flows.report.report_page import make_output_folder
from operators.errors import SlipflowError
from tests.scene.scene_measurements import NETWORK, Measurements, Size
from tests.scene.scene_report import scene_report

PAGE: Final = Path("explanations/scene.md")
FIGURES: Final = Path("figures")


def main() -> None:
    """Read the options, measure and write the page."""
    options = argparse.ArgumentParser(prog="python -m tests.scene", description=__doc__)
    options.add_argument("--seed", type=int, default=0, help="random seed of the recordings (default 0)")
    options.add_argument(
        "--judge", type=Path, help="weights of the paper's TCN (else its scores are skipped)"
    )
    options.add_argument("--trace", type=Path, help="labelled real trace, CSV (else its scores are skipped)")
    options.add_argument(
        "--out", type=Path, default=Path("docs"), help=f"folder for {PAGE} and figures (default docs)"
    )
    options.add_argument(
        "--plan", choices=PLANS, default="paper", help="collection plan; others than paper are a quick look"
    )
    given = options.parse_args()
    try:
        page = write_scene(
            given.out,
            seed=given.seed,
            judge=given.judge,
            trace=given.trace,
            size=Size.of(given.plan),
            command=f"--plan {given.plan}" if given.plan != "paper" else "",
            log=lambda text: print(text, file=sys.stderr, flush=True),
        )
    except SlipflowError as error:
        sys.exit(f"error: {error}")
    print(f"wrote {page} and its figures")


def write_scene(
    folder: Path,
    *,
    seed: int = 0,
    judge: Path | None = None,
    trace: Path | None = None,
    size: Size | None = None,
    command: str = "",
    log: Callable[[str], None] = lambda _: None,
) -> Path:
    """Measure the scene and write the page and its figures into a folder.

    Args:
        folder: Is created if it does not exist.
        seed: Of the recordings that detectors are evaluated on.
        judge: File with the weights of the paper's TCN; None: skip its scores.
        trace: Labelled real trace, CSV; None: skip its scores.
        size: Extent of the study; None: full.
        command: Further options, for the command on the page.
        log: Called with each step of the work, and each that is skipped.

    Returns:
        Path of the page.

    Raises:
        InputError: if a file is unusable, or matplotlib is not installed.
        EndpointError: if the folder cannot be created, before anything is measured.
    """
    require()
    for path in (folder / PAGE.parent, folder / FIGURES):
        make_output_folder(path)
    words = f"python -m tests.scene --seed {seed}"
    for option, file, lost in (("--judge", judge, NETWORK), ("--trace", trace, "the real trace")):
        if file is None:
            log(f"SKIPPED: {lost}, because {option} was not given")
        else:
            words += f" {option} {file.name}"
    report = scene_report(Measurements(seed, judge, trace, size or Size(), log), f"{words} {command}".strip())
    page = folder / PAGE
    page.write_text(report.markdown(f"../{FIGURES}/scene"), encoding="utf-8")
    for section in report.sections:
        (folder / FIGURES / f"scene-{section.name}.svg").write_text(section.svg, encoding="utf-8")
    return page


if __name__ == "__main__":
    main()
