"""At nominal load, a simulated fingertip has no faults: on the default rig and in the shipped plans."""

import numpy as np
import pytest

from connectors import SimulatedRig
from connectors.sim.finger import Finger, simulate_scene
from flows.lab.simulation import PLANS, planned_recordings
from operators import FaultKind, Touch
from tests.scene.scene_targets import degraded

MOST = 0.01  # share of samples
VARIED = {"wide": 0.06, "calm": 0.1}  # the same: some fingertips hardly respond, others too much


def faulty(touch: Touch) -> float:
    """Return the share of samples with a fault; a saturated cell is a limit of its range, not a fault."""
    return float(degraded(touch, FaultKind.SATURATED).mean())


@pytest.mark.parametrize("seed", range(3))
def test_the_default_rig_of_live_and_demo_has_no_faults(seed: int) -> None:
    taken = Finger(SimulatedRig(seed=seed).scene, seed).take(12_000)
    assert taken is not None
    assert faulty(taken[0]) <= MOST


@pytest.mark.parametrize("plan", PLANS)
def test_recordings_of_shipped_plans_have_hardly_any_faults(plan: str) -> None:
    touched = [
        simulate_scene(each.scene, each.seed)[0] for each in planned_recordings(plan, 0)[::4] if each.scene
    ]
    shares = [faulty(touch) for touch in touched]
    assert np.average(shares, weights=[len(touch) for touch in touched]) <= VARIED.get(plan, MOST)
