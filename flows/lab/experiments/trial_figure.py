"""A figure of one trial: force, barometers, probability of slip, slide and height against time."""

from typing import Final

from connectors.sim.objects import named
from flows.lab.experiments import lifting, tapping
from flows.lab.experiments.experiment import Found, one
from flows.lab.experiments.trial import BASELINE, Trace
from flows.lab.experiments.trial_setting import SLIDES, Setting
from flows.learn.onsets import runs
from flows.report.figures import CELLS, FAINT, INK, MAIN, SECOND, SHADE, Figure, grid, styled
from storage import load_detector

SHOWN: Final = "ball"  # the hardest for the paper


@styled
def example(of: Found) -> Figure:
    """The first trial of the first method with the object that is the hardest for the paper."""
    thing = SHOWN if SHOWN in of.objects else of.objects[0]
    grip = of.first.grip()
    detector = load_detector(of.first.detector)
    trace, outcome = one(of.kind, thing, of.seed, (detector, grip), of.conditions)
    least = Setting.drawn(named(thing), of.seed, of.conditions.nature).least
    figure, axes = grid(5, 1, (9, 8), sharex=True)
    force, counts, probability, slide, height = axes
    t = trace.t
    force.plot(t, trace.asked, color=FAINT, drawstyle="steps-post", label="commanded")
    force.plot(t, trace.force, color=MAIN, label="normal force")
    force.axhline(least, color=SECOND, linestyle="--", linewidth=0.9, label="least that holds")
    top = 1.3 * max(float(trace.asked.max()), least)  # room for the legend
    force.set(
        ylabel="N", ylim=(0, top), title=f"{of.first.name}: {thing.replace('_', ' ')}, {outcome.ending}"
    )
    force.legend(loc="upper left", ncols=3)
    for cell, color in enumerate(CELLS):
        counts.plot(t, trace.counts[:, cell], color=color, linewidth=0.8)
    counts.set(ylabel="counts", title="Barometers")
    probability.plot(t, trace.probability, color=INK)
    probability.axhline(grip.threshold, color=FAINT, linestyle="--", linewidth=0.9)
    probability.set(ylabel="", ylim=(0, 1), title="Probability of slip; shaded: it truly slides")
    slide.plot(t, 1000 * trace.slide, color=MAIN)
    slide.set(ylabel="mm", title="Slide along the pad")
    height.plot(t, 1000 * trace.hand, color=FAINT, label="hand")
    height.plot(t, 1000 * trace.height, color=MAIN, label="object")
    height.set(ylabel="mm", title="Height", xlabel="s", xlim=(BASELINE, t[-1]))
    height.legend(loc="upper left")
    for axis in axes:
        _shade(axis, trace)
        if of.kind == "tap":
            axis.axvline(tapping.BLOW, color=SECOND, linewidth=0.8)
        else:
            axis.axvline(lifting.LIFT.instant, color=FAINT, linewidth=0.8)
    return figure


def _shade(axis: Figure, trace: Trace) -> None:
    """Where it truly slides."""
    for first, end in runs(trace.speed > SLIDES).tolist():
        axis.axvspan(trace.t[max(first - 1, 0)], trace.t[end - 1], color=SHADE, linewidth=0)
