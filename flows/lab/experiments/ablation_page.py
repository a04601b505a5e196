"""Where the lift breaks, as a page."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from connectors.sim.objects import OBJECTS
from flows.lab.experiments import ablation_figure
from flows.lab.experiments.ablation_tables import NAME, sections, title
from flows.lab.experiments.lift_ablation import Ablation
from flows.lab.experiments.trial_measures import median, tried
from flows.learn.evaluation.sample_metrics import known
from flows.report.page import Page, drawn, terminal_text
from flows.report.report_files import write_page


def page(of: Ablation, command: str) -> Page:
    """The findings; `command` made them."""
    text = (
        f"{tried(of.nominal)}, the same under each condition. Success, %, by object; "
        "lost: out of the fingers, %; false: slips registered before anything slid, per trial. Slide and "
        "force are medians, force over the least that holds, where it is held."
    )
    first, *others = sections(of)
    shown = replace(first, figure=drawn(lambda: ablation_figure.panels(of, "\n".join(title(of)))))
    return Page("Where the lift breaks", text, [shown, *others], command)


def write(of: Ablation, folder: Path, command: str) -> list[Path]:
    """Write ``lift-ablation.html``, ``.md``, ``.json`` and ``.svg`` into a folder; their paths.

    Raises:
        EndpointError: if they cannot be written.
    """
    return write_page(page(of, command), summary(of), folder, NAME)


def text(of: Ablation) -> str:
    """What a person reads in a terminal."""
    return terminal_text(sections(of))


def summary(of: Ablation) -> dict[str, Any]:
    """For a program; NaN and infinity are null, and what breaks first where that cannot be told."""
    every = {**{f"+{delay} ms": found for delay, found in of.delays.items()}, **of.rates, **of.hard}
    return {
        "experiment": "lift-ablation",
        "trials": of.nominal.trials,
        "seed": of.nominal.seed,
        "methods": {
            method: {
                "breaks_first": of.first(method) if of.telling else None,
                "objects": {
                    thing: {
                        "breaks_ms": known(of.breaks(method, thing)),
                        "predicted_ms": known(of.predicted(method, thing)),
                        "loses_ms": known(of.loses(method, thing)),
                        "predicted_loses_ms": known(of.predicted(method, thing, lost=True)),
                    }
                    for thing in of.nominal.objects
                },
                "conditions": {
                    name: {
                        "mean_success": found.mean(method),
                        "objects": {thing: found.success(method, thing) for thing in found.objects},
                        "lost": {thing: of.lost(found, method, thing) for thing in found.objects},
                    }
                    for name, found in every.items()
                },
            }
            for method in of.methods
        },
        "budgets": {
            thing: {
                "reach_mm": 1000 * OBJECTS[thing].reach,
                "climbs_ms": known(1000 * median([each.climbs for each in found])),
                "falls_ms": known(1000 * median([each.falls for each in found])),
                "fell_ms": known(1000 * median([each.fell for each in found])),
                "climbed_ms": known(1000 * median([each.climbed for each in found])),
            }
            for thing, found in of.budgets.items()
        },
    }
