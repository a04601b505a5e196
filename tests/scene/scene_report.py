"""The scene's report: how real it looks, what each of its terms is worth, and how fast it is.

`write_report` measures everything anew and writes one Markdown page with figures beside it.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from flows.report.figures import require, save
from flows.report.report_files import make_output_folder, writing
from tests.scene import scene_sections
from tests.scene.scene_measured import NETWORK, Measured, Size

SECTIONS: Final = {
    "traces": scene_sections.traces,
    "realism": scene_sections.realism,
    "statistics": scene_sections.statistics,
    "ablation": scene_sections.ablation,
    "motion": scene_sections.motion,
    "speed": scene_sections.speeds,
}
HEAD: Final = """# The simulated scene, measured

Written by `slipflow simulate --report`; every number is of that run.

What was fitted to what: the scene's constants were fitted, all together, so that the paper's TCN, whose
weights come from real recordings, recognises slip in the simulation, and so that its level, spread, steps
and slip-to-static ratio are near the published ones. The search drew new recordings at each step; grip and
vibration were then set by hand on the plans of seeds 0 and 1, so other seeds are the cleaner test. The
score of that network and those statistics show how far the fit got, not that it generalises. The
differences between motions were not aimed at, nor was the real trace's score, though it was looked at
beside the simulation, and its score was seen while the default detector's inputs were chosen. Other networks
and another real trace are held back to judge the result.
"""


def write_report(
    folder: Path,
    *,
    seed: int = 0,
    judge: Path | None = None,
    trace: Path | None = None,
    size: Size | None = None,
    told: Callable[[str], None] = lambda _: None,
    form: str = "svg",
) -> Path:
    """Measure the scene; write ``scene.md`` and ``figures/scene-*`` into a folder.

    Args:
        folder: Is made where it does not exist.
        seed: Of the recordings that are judged.
        judge: File with the weights of the paper's TCN; without it, its judgement is skipped.
        trace: A real trace with labels, as CSV; without it, what needs one is skipped.
        size: How much is measured.
        told: Is told what is being done, and what is skipped.
        form: Of the figures: svg or png.

    Returns:
        The path of the page.

    Raises:
        InputError: if a file cannot be used, or matplotlib is not installed.
        EndpointError: if the folder cannot be made, which is tried first, or written to.
    """
    require()
    make_output_folder(folder)
    files = {"--judge": judge, "--trace": trace}
    for option, lost in (("--judge", NETWORK), ("--trace", "the real trace")):
        if files[option] is None:
            told(f"SKIPPED: {lost}, because {option} was not given")
    measured = Measured(seed, judge, trace, size or Size(), told)
    options = [f"{option} {path.name}" for option, path in files.items() if path is not None]
    command = " ".join(["slipflow simulate --report", folder.name, f"--seed {seed}", *options])
    page, path = [HEAD], folder / "scene.md"
    for name, make in SECTIONS.items():
        told(f"section: {name}")
        section = make(measured)
        figure = f"figures/scene-{name}.{form}"
        with writing(folder):
            save(section.figure, folder / figure)
        page += [f"## {section.title}", f"![{name}]({figure})", section.text, f"    {command}"]
    with writing(folder):
        path.write_text("\n\n".join(part.strip("\n") for part in page) + "\n", encoding="utf-8")
    return path
