from dataclasses import dataclass
from pathlib import Path
from shutil import copy
from typing import Any

import numpy as np

from flows.graph import Flow
from flows.graph.drawing import describe
from flows.graph.testing import TestSink, TestSource
from operators import Align, Debounce, Label, Motion, Score, Scores, Touch, Zero, ms
from storage import load_detector
from storage.models import shipped_path


@dataclass
class Held:
    value: Any
    other: Any = None


def test_text_reads_like_the_declaration() -> None:
    flow, sink = Flow("drawn"), TestSink()
    touch, motion = flow.source(TestSource(Touch)), flow.source(TestSource(Motion))
    zeroed = touch | Zero(baseline=400)
    (zeroed & motion | Align(within=10 * ms) | Label()).to(sink)
    zeroed.to(sink)
    assert str(flow).splitlines() == [
        "flow drawn",
        "  touch    = TestSource(Touch)",
        "  motion   = TestSource(Motion)",
        "  zeroed   = touch | Zero(baseline=400)",
        "  labelled = zeroed & motion | Align(within=10 ms) | Label()",
        "  labelled -> TestSink()",
        "  zeroed -> TestSink()",
    ]


def test_two_streams_of_one_type_get_two_names() -> None:
    flow = Flow("f")
    scores = flow.source(TestSource(Scores))
    for count in (2, 3):
        (scores | Debounce(consecutive=count)).to(TestSink())
    names = [line.split()[0] for line in str(flow).splitlines()[1:]]
    assert names == ["scores", "slips", "slips2", "slips", "slips2"]


def test_a_detector_is_drawn_by_the_name_of_its_model(tmp_path: Path) -> None:
    own = copy(shipped_path("tcn"), tmp_path / "mine.safetensors")
    assert [describe(Score(load_detector(name))) for name in ("tcn", own)] == [
        "Score(tcn)",
        "Score(mine.safetensors)",
    ]


def test_a_parameter_that_is_an_array_is_drawn() -> None:
    assert describe(Held(np.zeros(2))) == "Held(array([0., 0.]))"
    assert describe(Held(np.zeros(2), other=np.zeros(2))) == "Held(array([0., 0.]), other=array([0., 0.]))"
    assert describe(Held(describe)) == "Held(describe)"
