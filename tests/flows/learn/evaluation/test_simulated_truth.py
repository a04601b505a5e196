import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from connectors.sim.paper_plan import Collection
from connectors.sim.scene import Commanded, Faults, Plan, Scene, Strokes
from flows.learn.evaluation.simulated_truth import scene, with_truth
from flows.learn.labelled_recordings import LabelledRecording, load

PAPER = next(iter(Collection().scenes(0)))
SCENES = [PAPER, replace(PAPER, vibration=None, faults=Faults(dead=(1, 3), gain=(1.0,) * 6))]


@pytest.fixture(scope="module")
def recorded(tiny: Path) -> LabelledRecording:
    return load(tiny)[0]


@pytest.mark.parametrize("declared", SCENES, ids=["paper", "faulty"])
def test_a_scene_that_was_described_is_the_same_again(declared: Scene) -> None:
    assert scene(json.loads(json.dumps(asdict(declared)))) == declared


@pytest.mark.parametrize("plan", [Strokes(), Commanded()], ids=["strokes", "commanded"])
def test_a_plan_that_has_no_end_is_refused(plan: Plan) -> None:
    with pytest.raises(ValueError, match="no plan of a collection"):
        scene(asdict(replace(PAPER, plan=plan)))


def test_the_truth_of_a_simulated_session_is_found_again(tiny: Path, recorded: LabelledRecording) -> None:
    found = with_truth(tiny, recorded).sliding
    assert found is not None
    assert len(found) == len(recorded)
    assert 0.5 < (found == recorded.slip).mean() < 1


def test_the_truth_of_other_counts_is_not_believed(tiny: Path, recorded: LabelledRecording) -> None:
    counts = recorded.counts.copy()
    counts[500, 2] += 1
    assert with_truth(tiny, replace(recorded, counts=counts)).sliding is None


def test_a_session_that_says_no_scene_has_no_truth(
    tiny: Path, recorded: LabelledRecording, tmp_path: Path
) -> None:
    about = json.loads((tiny / "sessions" / recorded.name / "session.json").read_text())
    del about["check"]  # of what it said before
    folder = tmp_path / "sessions" / recorded.name
    folder.mkdir(parents=True)
    (folder / "MANIFEST.json").write_bytes((tiny / "sessions" / recorded.name / "MANIFEST.json").read_bytes())
    nonsense: list[dict[str, Any]] = [{}, {"scene": {}, "seed": 1}, {"scene": {"plan": {}}, "seed": 1}]
    for touch in (*nonsense, {"scene": 3}, {"scene": {"plan": 3}, "seed": 1}):
        about["sources"]["touch"] = touch
        (folder / "session.json").write_text(json.dumps(about))
        assert with_truth(tmp_path, recorded).sliding is None
    assert np.array_equal(with_truth(tmp_path / "none", recorded).counts, recorded.counts)
