import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy
from numpy.typing import NDArray

from operators import Debounce
from operators.detectors import TRAINED
from operators.errors import InputError
from storage import load_debounce, load_detector, save_weights
from storage.models import load_card, read_weights, save_card, shipped, shipped_names

weights = st.dictionaries(
    st.text(st.characters(codec="utf-8", exclude_characters="\0/"), min_size=1).filter(
        lambda name: name != "__metadata__"
    ),
    st_numpy.arrays(
        st.sampled_from(["<f4", ">f4", "f8", "i8", "u1", "?"]),
        st_numpy.array_shapes(min_dims=0, max_dims=3),
        elements={"allow_nan": False, "allow_infinity": False},
    ),
    min_size=1,
    max_size=4,
)


@settings(deadline=None)
@given(weights=weights, about=st.dictionaries(st.text(), st.text()), turned=st.booleans())
def test_weights_come_back_as_they_were_saved(
    tmp_path_factory: pytest.TempPathFactory,
    weights: dict[str, NDArray[Any]],
    about: dict[str, str],
    *,
    turned: bool,
) -> None:
    path = tmp_path_factory.getbasetemp() / "model.safetensors"
    if turned:  # no longer contiguous
        weights = {name: array.T for name, array in weights.items()}
    save_weights(path, weights, about)
    found, read = read_weights(path, path.read_bytes())
    assert read == about
    assert found.keys() == weights.keys()
    for name, array in weights.items():
        assert found[name].dtype == array.dtype.newbyteorder("=")
        assert found[name].shape == array.shape
        np.testing.assert_array_equal(found[name], array)


def test_weights_of_something_else_are_refused_by_the_name_of_their_file(tmp_path: Path) -> None:
    path = tmp_path / "other.safetensors"
    for detector, complaint in (
        *((name, r"other\.safetensors: .* is missing") for name in TRAINED),
        ("oracle", "is for detector 'oracle'"),
    ):
        save_weights(path, {"x": np.ones(3)}, {"detector": detector})
        with pytest.raises(InputError, match=complaint):
            load_detector(path)
    save_weights(path, {"good": np.ones(2), "bad": np.array([1.0, np.nan])})
    with pytest.raises(InputError, match="array 'bad' has values that are not finite"):
        load_detector(path)
    path.write_bytes((2**60).to_bytes(8, "little") + b"{}")
    with pytest.raises(InputError, match=r"is damaged or not a \.safetensors file"):
        load_detector(path)


@pytest.mark.parametrize("name", shipped_names())
def test_shipped_models_are_small_and_match_their_cards(name: str) -> None:
    path = shipped(name)
    assert path is not None
    card = load_card(path)
    assert card["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert name == card["detector"] == load_detector(name).name
    assert path.stat().st_size < 200_000
    assert {"data", "seed", "scores", "recipe", "software"} < card.keys()
    assert isinstance(load_debounce(name), Debounce)


def test_a_model_with_the_card_of_another_is_refused(tmp_path: Path) -> None:
    path = shipped("tcn")
    assert path is not None
    (tmp_path / "model.safetensors").write_bytes(path.read_bytes())
    save_card(tmp_path / "model.safetensors", {**load_card(path), "sha256": "0" * 64})
    with pytest.raises(InputError, match=r"is damaged, or not the model of model\.json"):
        load_detector(tmp_path / "model.safetensors")
