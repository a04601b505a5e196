"""Simulated datasets: reproducible, complete or absent, and the same as a live recording."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from connectors import SimulatedRig
from connectors.sim.drawn_grasp import simulate_grasp
from flows.graph import Flow
from flows.graph.testing import run_virtually
from flows.lab import simulation
from flows.lab.simulation import planned_recordings, simulate
from flows.record import declare_recording
from flows.run.clocks import LoopClock
from flows.run.executor import workers
from flows.run.live_runner import LiveRunner
from operators import Label
from operators.batch import SLIP, STATIC
from operators.fingertip import TAKKTILE
from storage import Dataset, Session
from tests.storage.made import contents


def sessions(dataset: Path) -> list[Session]:
    return [Session.open(path) for path in sorted((dataset / "sessions").iterdir())]


def test_the_same_seed_gives_the_same_bytes_in_any_number_of_processes_and_another_seed_others(
    tmp_path: Path, tiny: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulation, "planned_recordings", lambda *plan: planned_recordings(*plan)[:3])
    (tmp_path / "empty").mkdir()
    with workers(2) as executor:
        again = contents(simulate(tmp_path / "empty", "tiny", 0, executor=executor))
    assert again.items() <= contents(tiny).items()
    other = contents(simulate(tmp_path / "other", "tiny", 1))
    assert {path for path, content in other.items() if again[path] == content} == {"dataset.json"}
    assert len(other) == len(again) > 15


def test_every_session_is_complete_and_readable(tiny: Path) -> None:
    planned = {each.session: each for each in planned_recordings("tiny", 0)}
    found = sessions(tiny)
    assert {session.name for session in found} == set(planned)
    for session in found:
        about = session.about
        assert about["complete"] is True
        assert (about["host"], about["start_ns"]) == (None, planned[session.name].start)
        assert session.about["fingertips"] == dict.fromkeys(("touch", "samples"), TAKKTILE.describe())
        assert session.tables == ("touch", "motion", "samples", "episodes", "truth")
        assert about["split"] == planned[session.name].split
        scene = planned[session.name].scene
        assert scene
        assert set(session.frame("episodes")["surface"]) == {scene.curvature}


def test_a_grasp_is_labelled_by_true_sliding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "_GRASPS", 3)
    done = simulate(tmp_path / "grasps", "grasps", 4)
    assert [session.name for session in sessions(done)] == ["grasp-000", "grasp-001", "grasp-002"]
    seen = set[int]()
    for number, session in enumerate(sessions(done)):
        travel = np.cumsum(simulate_grasp(4, number)[1].sliding) / 100  # m
        label = session.frame("samples")["label"].to_numpy()
        assert len(label) == len(travel)
        slid = travel[15:] - travel[:-15]  # m in 150 ms
        slid = np.max([np.roll(slid, shift) for shift in (-1, 0, 1, 2)], axis=0)  # aligned within 20 ms
        assert (slid[label[15:] == SLIP] > 0.00045 - 1e-9).all()
        assert ((travel[25:] - travel[3:-22])[label[25:] == STATIC] < 0.00025 + 1e-9).all()
        seen |= {*label.tolist()}
    assert seen == {-1, STATIC, SLIP}


def test_a_session_is_the_same_as_a_live_recording_of_the_scene(tmp_path: Path, tiny: Path) -> None:
    planned = planned_recordings("tiny", 0)[1]

    async def live() -> None:
        flow = Flow("simulate")
        rig = SimulatedRig(planned.scene, planned.seed)
        declare_recording(flow, rig, Label(speed=0.003), Dataset(tmp_path))
        await LiveRunner(flow, planned.session, clock=LoopClock(planned.start)).execute()

    run_virtually(live())
    recorded, simulated = Session.open(tmp_path), Session.open(tiny / "sessions" / planned.session)
    for table in ("touch", "motion", "samples", "episodes", "truth"):
        assert recorded.frame(table).equals(simulated.frame(table)), table
    sources: Any = simulated.about["sources"]
    added = {name: sources["touch"].pop(name) for name in ("plan", "plan_seed", "split")}
    assert added == {"plan": "tiny", "plan_seed": 0, "split": planned.split}
    assert recorded.about["sources"] == sources


@pytest.mark.parametrize("seed", [0, 1, 12345])
def test_the_papers_plan_is_split_by_recording_with_every_kind_in_every_split(seed: int) -> None:
    planned = planned_recordings("paper", seed)
    assert len({each.session for each in planned}) == len(planned) == 128
    assert len({each.start for each in planned}) == len({each.seed for each in planned}) == 128
    count = Counter(each.split for each in planned)
    assert (count["train"], count["validation"], count["test"]) == (89, 13, 26)
    groups = Counter((each.session[:-3], each.split) for each in planned)
    for curvature in ("plane", "sphere", "cylinder_x", "cylinder_y"):
        assert groups[f"{curvature}-rotation", "test"] == 1
        for speed in ("050", "075", "100"):
            group = f"{curvature}-{speed}"
            assert 5 <= groups[group, "train"] <= 7
            assert 1 <= groups[group, "test"] <= 2
        assert 2 <= sum(groups[f"{curvature}-{speed}", "validation"] for speed in ("050", "075", "100")) <= 3
