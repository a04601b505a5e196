from dataclasses import replace
from pathlib import Path
from shutil import copy

import numpy as np
import pytest

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow
from flows.graph.testing import TestSink
from flows.graph.validation import problems
from operators import Health, Pool, Score, Touch, Zero, Zeroed, ms, s
from operators.batch import Faults
from operators.detectors import Psd
from operators.errors import FingertipError, FlowError
from operators.fingertip import TAKKTILE, Fingertip, grid
from storage import load_detector
from storage.models import shipped_path
from tests.flows.run.live import Described, flow_of


def flow(fingertip: Fingertip, score: Score) -> Flow:
    return flow_of(Described(fingertip), TestSink(), through=[Zero(), score])


@pytest.mark.parametrize(
    ("given", "fix"),
    [
        (replace(TAKKTILE, rate=200.0), r"Resample\(rate=100\) in a flow converts it"),
        (replace(TAKKTILE, layout=grid(16)), r"Pool\(groups=\.\.\.\)"),
    ],
)
def test_a_detector_for_another_fingertip_is_an_error_that_names_edge_and_operator(
    given: Fingertip, fix: str
) -> None:
    made = flow(given, Score(load_detector("tcn")))
    [problem] = problems(made)
    assert isinstance(problem.__cause__, FingertipError)
    with pytest.raises(FlowError, match=rf"^flow 'f': Zero -> Score: tcn needs .*: {fix}"):
        CompiledFlow(made)


def test_the_error_names_the_model_and_not_its_kind(tmp_path: Path) -> None:
    own = copy(shipped_path("tcn"), tmp_path / "mine.safetensors")
    [problem] = problems(flow(replace(TAKKTILE, rate=200.0), Score(load_detector(own))))
    assert "mine.safetensors needs 100 Hz; the data has 200 Hz" in problem.reason


def test_a_detector_that_fits_or_does_not_say_is_accepted() -> None:
    assert problems(flow(TAKKTILE, Score(load_detector("tcn")))) == []
    assert problems(flow(replace(TAKKTILE, layout=grid(16)), Score(Psd()))) == []
    assert len(problems(flow(replace(TAKKTILE, rate=50.0), Score(Psd())))) == 1


@pytest.mark.parametrize(
    ("ends", "found"), [((1023, 0), [[1]]), ((0, 4095), [[0]]), ((-40, 4095), []), (None, [])]
)
def test_cells_at_the_end_of_their_fingertips_range_are_saturated(
    ends: tuple[int, int] | None, found: list[int]
) -> None:
    described = Described(replace(TAKKTILE, range=ends))
    made = flow_of(described, TestSink(), through=[Pool(), Health(stuck_after=9 * s)])
    time, cells = np.arange(0, s, 10 * ms), np.full((100, 6), 500, np.int16)
    cells[10:, :2] = 40, 1020
    touch = Touch(time, cells, cells, np.ones_like(cells, np.bool_))
    compiled = CompiledFlow(made)
    saturated = [
        batch.barometer.tolist()
        for _, batch in compiled.push({compiled.entries[0]: touch})
        if isinstance(batch, Faults)
    ]
    assert saturated == found


def test_a_sink_learns_the_fingertips_of_its_streams() -> None:
    made, sink = Flow("record"), TestSink("data")
    touch = made.source(Described(TAKKTILE))
    touch.to(sink)
    (touch | Zero()).to(sink)
    assert CompiledFlow(made).fingertips == {"data": {Touch: TAKKTILE, Zeroed: TAKKTILE}}
