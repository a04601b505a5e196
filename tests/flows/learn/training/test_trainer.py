import hashlib
import json
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

from flows.learn.labelled_recordings import LabelledRecording, by_split, labelled_by, load
from flows.learn.leaks.leak import SEEN
from flows.learn.training import trainer
from flows.learn.training.learning_curve import Check, best, draw
from flows.learn.training.recipe import Recipe
from flows.learn.training.trained_model import label_scores, provenance
from flows.learn.training.trainer import train
from operators.detectors import PaperTcn, Tcn
from operators.errors import InputError, ParameterError
from storage import load_detector
from storage.description import describe_dataset
from storage.models import load_card, save_card

SMALL = Recipe(filters=4, units=4, steps=60, batch=8, checks=3, rate=2e-2)


def test_a_model_and_its_card_say_where_they_come_from(tiny: Path, tmp_path: Path) -> None:
    reported: list[tuple[str, int, int, Check | None]] = []

    def report(what: str, done: int, of: int, check: Check | None) -> None:
        reported.append((what, done, of, check))

    out = tmp_path / "model.safetensors"
    outcome = train([tiny], out, recipe=SMALL, progress=report)
    card = json.loads((tmp_path / "model.json").read_text())
    assert card["sha256"] == hashlib.sha256(out.read_bytes()).hexdigest()
    assert (card["detector"], card["target"]) == ("tcn", "arm-speed")
    assert card["data"][0]["recordings"]["train"] > card["data"][0]["recordings"]["test"]
    assert card["recipe"]["filters"] == 4
    assert card["scores"]["test"]["accuracy"] > 55
    assert [each[1] for each in reported] == list(range(1, 61))
    assert sum(each[3] is not None for each in reported) == 3
    assert "% on validation" in outcome.report()
    assert "(seed 0, trained now)" in outcome.report()
    assert "The validation split selected the checkpoint" in outcome.report()
    assert outcome.summary()["models"][0]["path"] == str(out)
    assert isinstance(load_detector(out), Tcn)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.json", "model.safetensors"]


def test_a_stretched_model_has_a_longer_window(tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "model.safetensors"
    [model] = train([tiny], out, recipe=replace(SMALL, steps=6).stretched_by(2)).models
    tcn = load_detector(out)
    assert isinstance(tcn, Tcn)
    assert tcn.length == 198
    assert model.card["recipe"]["stretch"] == 2
    unstretched = [recording for recording in load(tiny) if recording.split == "test"]
    assert model.card["scores"]["test"] != label_scores(tcn, unstretched)
    assert SMALL.stretched_by(1) is SMALL


def test_of_several_seeds_the_best_on_validation_is_the_model(tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "model.safetensors"
    outcome = train([tiny], out, recipe=replace(SMALL, steps=15), seeds=2)
    scores = [model.card["scores"]["validation"]["balanced"] for model in outcome.models]
    assert scores == sorted(scores, reverse=True)
    assert out.read_bytes() == outcome.models[0].path.read_bytes()
    assert {model.path.stem for model in outcome.models} == {"model-seed0", "model-seed1"}
    assert "seed sd" in outcome.report()


def test_a_network_of_the_paper_is_trained_by_its_recipe(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def few(dataset: Path, **_: object) -> list[LabelledRecording]:
        return [found[0] for found in by_split(load(dataset)).values()]

    monkeypatch.setattr(trainer, "load", few)
    out = tmp_path / "paper.safetensors"
    outcome = train([tiny], out, method="paper_tcn", epochs=1)
    assert isinstance(load_detector(out), PaperTcn)
    assert outcome.models[0].card["recipe"]["batch"] == 256
    assert len(outcome.models[0].curve) == 1


def test_a_network_can_learn_true_sliding(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "model.safetensors"
    [model] = train([tiny], out, recipe=replace(SMALL, steps=6), target="sliding").models
    assert model.card["target"] == "sliding"
    test = [recording for recording in load(tiny) if recording.split == "test"]
    assert model.card["scores"]["test"] == label_scores(load_detector(out), labelled_by("sliding", test))

    def unknown(dataset: Path, **_: object) -> list[LabelledRecording]:
        return [replace(each, sliding=None) for each in load(dataset)]

    monkeypatch.setattr(trainer, "load", unknown)
    with pytest.raises(InputError, match="has no truth table to learn sliding from; `slipflow simulate`"):
        train([tiny], out, recipe=SMALL, target="sliding")


def test_a_model_with_the_same_data_and_settings_is_kept_on_request(tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "model.safetensors"

    def trained(seeds: int, steps: int, target: str = "arm-speed") -> set[str]:
        """Return the seeds that were trained."""
        found = set[str]()

        def report(seed: str, *_: object) -> None:
            found.add(seed)

        recipe = replace(SMALL, steps=steps)
        train([tiny], out, recipe=recipe, seeds=seeds, target=target, resume=True, progress=report)
        return found

    assert trained(2, 4) == {"seed 0", "seed 1"}
    kept = out.read_bytes()
    assert trained(2, 4) == set()
    assert out.read_bytes() == kept
    assert trained(3, 4) == {"seed 2"}
    assert trained(2, 4, "sliding") == {"seed 0", "seed 1"}
    assert trained(2, 5, "sliding") == {"seed 0", "seed 1"}
    out.with_stem("model-seed1").write_bytes(b"damaged")
    assert trained(2, 5, "sliding") == {"seed 1"}


def test_leaks_between_splits_are_named_and_listed_in_the_card(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def copied(dataset: Path, **_: object) -> list[LabelledRecording]:
        everything = load(dataset)
        return [*everything, replace(everything[0], name="copy", split="validation")]

    monkeypatch.setattr(trainer, "load", copied)
    warnings: list[str] = []
    found = train([tiny], tmp_path / "m.safetensors", recipe=replace(SMALL, steps=2), warn=warnings.append)
    [leak] = found.leaks
    assert leak.kind == "shared rows"
    assert warnings == [f"leak: {leak.finding}"]
    assert found.models[0].card["leaks"] == found.summary()["leaks"] == [leak.json()]


def test_a_card_lists_its_recordings_and_an_older_one_is_completed(tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.safetensors"
    recipe = replace(SMALL, steps=2)
    [model] = train([tiny], out, recipe=recipe).models
    names = {name for name, _ in model.card[SEEN]["train"]["recordings"]}
    assert names == {each.name for each in load(tiny) if each.split == "train"}
    save_card(out, {name: value for name, value in model.card.items() if name != SEEN})
    said = list[str]()
    resumed = train([tiny], out, recipe=recipe, resume=True, warn=said.append)
    [again] = resumed.models
    assert f"{out}: kept from an earlier run with the same data and settings" in said
    assert "(seed 0, kept from an earlier run)" in resumed.report()
    assert resumed.summary()["models"][0]["kept"] is True
    assert again.card[SEEN] == load_card(out)[SEEN] == model.card[SEEN]
    assert again.card["sha256"] == model.card["sha256"]


def test_the_sha256_of_the_data_changes_with_the_data(tiny: Path, tmp_path: Path) -> None:
    other = copytree(tiny, tmp_path / "other")
    manifest = next(other.glob("sessions/*/MANIFEST.json"))
    manifest.write_bytes(manifest.read_bytes() + b"\n")
    sums = [provenance(path, [])["sha256"] for path in (tiny, tiny, other)]
    assert sums[0] == sums[1] != sums[2]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"method": "oracle"}, "method"),
        ({"target": "speed"}, "target"),
        ({"seeds": 0}, "seeds"),
        ({"lag": -0.02}, "lag"),
        ({"lag": float("nan")}, "lag"),
        ({"out": "model.pt"}, r"ends in \.safetensors"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_read(
    tmp_path: Path, arguments: dict[str, str], reason: str
) -> None:
    out = tmp_path / str(arguments.pop("out", "model.safetensors"))
    with pytest.raises(ParameterError, match=reason):
        train([tmp_path / "nothing"], out, **arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("split", ["validation", "test"])
def test_a_split_without_labels_after_the_warm_up_is_refused(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, split: str
) -> None:
    def short(dataset: Path, **_: object) -> list[LabelledRecording]:
        found = [parts[0] for parts in by_split(load(dataset)).values()]
        return [each.piece(slice(0, 99)) if each.split == split else each for each in found]

    monkeypatch.setattr(trainer, "load", short)
    with pytest.raises(ParameterError, match=f"{split} recordings with labels after their warm-up of 0.99 s"):
        train([tiny], tmp_path / "model.safetensors", recipe=replace(SMALL, steps=6))


def test_a_dataset_without_samples_is_an_input_error(tmp_path: Path) -> None:
    describe_dataset(tmp_path)
    with pytest.raises(InputError, match="no labelled samples"):
        train([tmp_path], tmp_path / "model.safetensors")


def test_the_curve_names_the_time_of_the_best_check() -> None:
    curve = [
        Check(1, 60.0, 0.5, 80.0, 80.0),
        Check(2, 120.0, 0.4, 90.0, 90.0),
        Check(3, 180.0, 0.4, 89.0, 89.0),
    ]
    assert best(curve).done == 2
    (axes,) = draw({"seed 0": curve}).axes
    assert "2.0 minutes" in axes.get_title(loc="left")
    assert np.array_equal(axes.lines[0].get_ydata(), [80.0, 90.0, 89.0])
