import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flows.learn.evaluation.methods import Method, for_fingertip, trained_methods, with_baselines
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.scoring import probabilities
from operators import Debounce
from operators.detectors import TRAINED, Psd
from operators.detectors.paper_tcn import shapes
from operators.errors import FingertipError, InputError
from operators.fingertip import TAKKTILE
from storage import save_weights
from storage.models import shipped_names


@pytest.fixture(scope="module")
def training() -> list[LabelledRecording]:
    """Two recordings in which slip shakes every barometer."""
    random = np.random.default_rng(0)
    label = np.repeat(np.arange(16) % 2, 50).astype(np.int8)
    spread = np.where(label, 40, 1)[:, None]
    counts = (random.normal(0, spread, (800, 6)).round().astype(np.int16) for _ in range(2))
    return [LabelledRecording(each, label, "plane", split="train") for each in counts]


def model(path: Path, **about: object) -> Path:
    """A file of the paper's network, with a card."""
    random = np.random.default_rng(0)
    weights = {name: random.normal(size=shape).astype(np.float32) + 1 for name, shape in shapes().items()}
    weights["std"] = np.abs(weights["std"])
    save_weights(path, weights, {"detector": "paper_tcn"})
    if about:
        path.with_suffix(".json").write_text(json.dumps(about))
    return path


def methods(
    training: Sequence[LabelledRecording],
    models: Sequence[Path] = (),
    names: Collection[str] = (),
    log: Callable[[str], object] = lambda _: None,
) -> tuple[list[Method], dict[str, str]]:
    return with_baselines(trained_methods(models, names), training, names, log)


def test_baselines_are_fitted_to_the_training_split(training: list[LabelledRecording]) -> None:
    found, missing = methods(training, names=["psd", "psd_1s", "logistic"])
    assert {method.name: method.detector.length for method in found} == {
        "logistic": 41,
        "psd": 25,
        "psd_1s": 100,
    }
    assert not missing
    psd = next(method.detector for method in found if method.name == "psd")
    assert isinstance(psd, Psd)
    assert psd.threshold != Psd().threshold


def test_baselines_are_fitted_at_the_rate_and_in_the_unit_of_their_data(
    training: list[LabelledRecording],
) -> None:
    fingertip = replace(TAKKTILE, rate=200.0, unit="kPa", resolution=0.01)
    fast = [replace(each, fingertip=fingertip) for each in training]
    found, missing = methods(fast, names=["psd", "psd_1s", "logistic"])
    assert not missing
    assert {method.name: method.detector.length for method in found} == {
        "logistic": 81,
        "psd": 50,
        "psd_1s": 200,
    }
    for method in found:
        assert np.isfinite(probabilities(method.detector, fast[0])[-1])
    with pytest.raises(FingertipError, match=r"psd needs steps of 0\.01 kPa, 200 Hz; the data has count"):
        probabilities(found[1].detector, training[0])


def test_a_rate_that_is_too_low_for_the_frequencies_of_psd_is_a_reason(
    training: list[LabelledRecording],
) -> None:
    slow = [replace(each, fingertip=replace(TAKKTILE, rate=16.0)) for each in training]
    found, missing = methods(slow, names=["psd", "logistic"])
    assert [method.name for method in found] == ["logistic"]
    assert "below 7.68 Hz" in missing["psd"]


def test_methods_for_other_fingertips_are_missing_before_anything_is_fitted(
    training: list[LabelledRecording],
) -> None:
    log = list[str]()
    fast = [replace(each, fingertip=replace(TAKKTILE, rate=200.0)) for each in training]
    trained = trained_methods(names=["tcn", "psd"])
    left, misfits = for_fingertip(trained, fast[0].fingertip, log.append)
    found, missing = with_baselines(left, fast, ["tcn", "psd"], log.append, misfits)
    assert [method.name for method in found] == ["psd"]
    assert "tcn needs 100 Hz; the data has 200 Hz: Resample(rate=100)" in missing["tcn"]
    assert log == [f"not evaluated: tcn: {missing['tcn']}", "fitting psd"]


def test_without_a_training_split_baselines_are_missing_with_a_reason() -> None:
    found, missing = methods([], names=["psd", "gradient_boosting"])
    assert found == []
    assert set(missing) == {"psd", "gradient_boosting"}
    assert "no train split" in missing["psd"]


def test_a_model_is_named_as_its_detector_and_the_next_of_its_kind_as_its_file(tmp_path: Path) -> None:
    files = [model(tmp_path / f"{name}.safetensors") for name in ("one", "two")]
    folder = tmp_path / "again"
    folder.mkdir()
    files.append(model(folder / "two.safetensors"))
    names = [method.name for method in methods([], files)[0]]
    assert names == [*shipped_names(), "one", "two", "two_2"]  # the paper's network ships: its name is taken


def test_every_trained_method_is_found_or_missing(training: list[LabelledRecording]) -> None:
    found, missing = methods(training[:1], names=[*TRAINED, "psd"])
    assert {method.name for method in found} | set(missing) == {*TRAINED, "psd"}


def test_only_requested_baselines_are_fitted(training: list[LabelledRecording]) -> None:
    log = list[str]()
    methods(training, names=["psd"], log=log.append)
    assert log == ["fitting psd"]


def test_an_unknown_method_is_refused(training: list[LabelledRecording]) -> None:
    with pytest.raises(InputError, match="oracle: is not a method; known are"):
        methods(training, names=["psd", "oracle"])


def test_the_debounce_of_a_model_is_that_of_its_card(tmp_path: Path) -> None:
    settings: dict[str, Any] = {"threshold": 0.8, "consecutive": 3, "release": 8}
    path = model(tmp_path / "slow.safetensors", debounce=settings)
    [method] = [each for each in methods([], [path])[0] if each.origin == path.name]
    assert method.debounce == Debounce(**settings)


def test_a_card_with_invalid_debounce_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"odd\.json: debounce"):
        methods([], [model(tmp_path / "odd.safetensors", debounce={"speed": 1})])
    with pytest.raises(InputError, match=r"odd\.json: debounce"):
        methods([], [model(tmp_path / "odd.safetensors", debounce={"consecutive": 0})])
