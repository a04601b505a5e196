import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from shutil import copy

import numpy as np
import pytest

from flows.learn.evaluation.folds import Fold
from flows.learn.evaluation.methods import PAPER_RULE, FittedMethod, baselines, trained_methods
from flows.learn.event_metrics import tuned_on
from flows.learn.labelled_recordings import LabelledRecording
from operators import Debounce
from operators.detectors import Detector
from operators.errors import FingertipError, InputError, ParameterError
from operators.fingertip import TAKKTILE
from storage.models import shipped_names, shipped_path


def model(path: Path) -> Path:
    """A file of the paper's network."""
    copy(shipped_path("paper_tcn"), path)
    return path


def fitted(training: Sequence[LabelledRecording], *names: str) -> dict[str, Detector]:
    fold = Fold("", training, [], training)
    return {each.name: each.fit(fold).detector for each in baselines(names)}


def test_baselines_are_fitted_at_the_rate_and_in_the_unit_of_their_data(
    surfaces: list[LabelledRecording],
) -> None:
    fingertip = replace(TAKKTILE, rate=200.0, unit="kPa", resolution=0.01)
    fast = [replace(each, fingertip=fingertip) for each in surfaces]
    found = fitted(fast, "psd", "psd_1s", "logistic")
    assert {name: each.length for name, each in found.items()} == {"logistic": 101, "psd": 50, "psd_1s": 200}
    for detector in found.values():
        assert np.isfinite(fast[0].probabilities(detector)[-1])
    with pytest.raises(FingertipError, match=r"psd needs steps of 0\.01 kPa, 200 Hz; the data has count"):
        surfaces[0].probabilities(found["psd"])


def test_a_rate_that_is_too_low_for_the_frequencies_of_psd_is_a_reason(
    surfaces: list[LabelledRecording],
) -> None:
    slow = [replace(each, fingertip=replace(TAKKTILE, rate=16.0)) for each in surfaces]
    with pytest.raises(ParameterError, match=r"below 7\.68 Hz"):
        fitted(slow, "psd")


def test_a_debounce_is_that_of_the_card_or_tuned_or_the_papers(surfaces: list[LabelledRecording]) -> None:
    own, psd = Debounce(0.8, 3, 8), FittedMethod("psd", fitted(surfaces, "psd")["psd"])
    fold = Fold("", surfaces, surfaces, surfaces)
    tuned = tuned_on(surfaces, psd.detector)
    for method, learned, debounce, origin in (
        (replace(psd, debounce=own), fold, own, "its card"),
        (psd, fold, tuned, "validation"),
        (psd, replace(fold, validation=[]), PAPER_RULE, "the paper"),
    ):
        chosen = method.debounced(learned)
        assert (chosen.debounce, chosen.chosen_on) == (debounce, origin)


def test_a_model_is_named_as_its_file_so_that_none_has_the_name_of_a_shipped_one(tmp_path: Path) -> None:
    files = [str(model(tmp_path / f"{name}.safetensors")) for name in ("one", "tcn")]
    names = [method.name for method in trained_methods([*files, *files])]
    assert names == [*shipped_names(), *files]
    [alone] = trained_methods([files[-1], "psd"])
    assert alone.name == files[-1]


@pytest.mark.parametrize("settings", [{"speed": 1}, {"consecutive": 0}])
def test_a_card_with_invalid_debounce_is_refused(tmp_path: Path, settings: dict[str, int]) -> None:
    path = model(tmp_path / "odd.safetensors")
    path.with_suffix(".json").write_text(json.dumps({"debounce": settings}))
    with pytest.raises(InputError, match=r"odd\.json: debounce"):
        trained_methods([str(path)])
