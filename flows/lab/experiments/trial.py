"""One trial: a grasp in the scene and the declared flow, sample by sample in virtual time."""

from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np

from connectors.sim.grasp import Grasp, Held
from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.graph.testing import TestSink, TestSource
from flows.lab.experiments.hand_model import Grasping
from flows.lab.experiments.trial_setting import Conditions
from flows.lift import held_by
from operators.batch import BAROMETERS, Commands, Counts, Flags, Reals, Scores, Touch, s
from operators.detectors import Detector
from operators.grip import GripController

By: TypeAlias = tuple[Detector, GripController]

BASELINE: Final = 1.0  # s with an open hand, before everything


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """What happened in a trial, sample by sample, and what the flow made of it."""

    t: Reals  # (n,) s
    counts: Counts  # (n, 6) relative to the open hand
    probability: Reals  # (n,) NaN where there was no score
    asked: Reals  # (n,) N, by the newest command
    force: Reals  # (n,) N, normal
    slide: Reals  # (n,) m, how far the object is from where it was gripped
    speed: Reals  # (n,) m/s, of sliding
    height: Reals  # (n,) m, of the object
    hand: Reals  # (n,) m, height of the hand
    on_table: Flags  # (n,)
    dropped: Flags  # (n,)

    def __len__(self) -> int:
        return len(self.t)

    def between(self, since: float, until: float) -> slice:
        """The samples of a span of time (s)."""
        first, last = np.searchsorted(self.t, [since, until]).tolist()
        return slice(first, last)


def run(grasp: Grasp, by: By, conditions: Conditions, seconds: float) -> Trace:
    """Carry a trial out.

    The open hand is scanned as often as the detector needs for its first score, however slow the rate is.

    Args:
        grasp: From its beginning on, with an open hand that waits for the first command.
        by: What feels slip, and what rules the force.
        conditions: The hand that obeys, and how often it is felt.
        seconds: How long.
    """
    rate, every = conditions.rate, conditions.every
    flow, notes, told = Flow("trial"), TestSink(), TestSink()
    waits = round(rate * BASELINE)
    scans = max(waits, by[0].length)
    scores, commands = held_by(flow, TestSource(Touch, fingers=(0,)), *by, scans)
    scores.to(notes)
    commands.to(told)
    plan = CompiledFlow(flow)
    [entry] = plan.entries
    mechanics = Grasping(conditions.hand, grasp)
    instants = np.concatenate((np.arange(scans) / scans * BASELINE, np.arange(waits, seconds * rate) / rate))
    n, stamps = len(instants), np.rint(instants * s).astype(np.int64)
    happened: list[Held] = []
    counts = np.zeros((n, BAROMETERS), np.int16)
    probability, asked = np.full(n, np.nan), np.zeros(n)
    reading = Touch.empty()
    for k, instant in enumerate(instants.tolist()):
        touch, held = grasp.sense(instant)
        if k < scans or (k - scans) % every == 0:
            reading = touch
        touch = replace(reading, time=touch.time)
        happened.append(held)
        counts[k] = touch.counts[0]
        for _, batch in plan.push({entry: touch}):
            if isinstance(batch, Scores):
                probability[np.searchsorted(stamps, batch.time)] = batch.probability
            elif isinstance(batch, Commands):
                mechanics.take(batch)
        asked[k] = mechanics.asked
    base = np.rint(np.median(counts[:scans], axis=0)).astype(np.int16)
    return Trace(
        np.array([held.instant for held in happened]),
        counts - base,
        probability,
        asked,
        np.array([held.force for held in happened]),
        np.array([np.hypot(held.slide_x, held.slide_y) for held in happened]),
        np.array([held.speed for held in happened]),
        np.array([held.height for held in happened]),
        np.array([held.hand for held in happened]),
        np.array([held.on_table for held in happened]),
        np.array([held.dropped for held in happened]),
    )
