from importlib import import_module
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch

from flows.learn.training.onnx_export import export_onnx
from flows.learn.training.recipe import Recipe
from flows.learn.training.tcn_module import DenseTcn
from operators.detectors import Tcn


@pytest.mark.parametrize(
    ("recipe", "cells"),
    [(Recipe(), 6), (Recipe(), 16), (Recipe(filters=12, taps=4, dilations=(1, 2, 4, 8), units=6), 6)],
)
def test_onnxruntime_agrees_with_the_detector(tmp_path: Path, recipe: Recipe, cells: int) -> None:
    cast("Any", torch).manual_seed(3)
    tcn = Tcn(DenseTcn(recipe, cells).arrays())
    export_onnx(tcn, tmp_path / "model.onnx")
    onnx: Any = import_module("onnx")
    onnx.checker.check_model(str(tmp_path / "model.onnx"), full_check=True)
    onnxruntime: Any = import_module("onnxruntime")
    session = onnxruntime.InferenceSession(str(tmp_path / "model.onnx"))
    steps = np.random.default_rng(0).normal(0, 30, (20, tcn.length, cells))
    counts = steps.cumsum(axis=1).round().clip(-500, 200).astype(np.int16)
    (found,) = session.run(["probability"], {"counts": counts.astype(np.float32)})
    assert np.ptp(found) > 0
    np.testing.assert_allclose(found, tcn.score(counts), atol=1e-5)
    streamed = tcn.stream(len(counts)).push(counts.transpose(1, 0, 2))[-1]
    np.testing.assert_allclose(found, streamed, atol=1e-5)
