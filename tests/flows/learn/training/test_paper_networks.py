from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from flows.learn.training.paper_networks import PaperNetwork, paper_network
from flows.learn.training.recipe import PaperRecipe
from flows.learn.training.trained_model import Arrays
from operators.detectors import Detector, PaperTcn
from operators.detectors.frequency_cnn import InterleavedFrequencyCnn

DETECTORS: dict[str, Callable[[Arrays], Detector]] = {
    "frequency_cnn_interleaved": InterleavedFrequencyCnn,
    "paper_tcn": PaperTcn,
}

every = pytest.mark.parametrize("name", DETECTORS)


def _network(name: str, generator: torch.Generator) -> PaperNetwork:
    """Return a network with weights and running statistics that are nowhere 0 or 1."""
    network = paper_network(name, np.linspace(-200, 0, 6), np.linspace(180, 60, 6), PaperRecipe())
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(torch.randn(parameter.shape, generator=generator), alpha=0.1)
        for _ in range(20):
            network(_counts(64, generator))
    return network.eval()


def _counts(windows: int, generator: torch.Generator) -> Tensor:
    levels = -300 * torch.rand(windows, 1, 6, generator=generator)
    return (levels + 40 * torch.randn(windows, 100, 6, generator=generator)).round()


@every
def test_the_detector_of_the_exported_arrays_gives_the_networks_probabilities(name: str) -> None:
    generator = torch.Generator().manual_seed(0)
    network, counts = _network(name, generator), _counts(200, generator)
    detector: Detector = DETECTORS[name](network.arrays())
    with torch.no_grad():
        expected = network(counts).softmax(1)[:, 1].numpy()
    assert np.ptp(expected) > 0.2
    assert detector.name == name
    np.testing.assert_allclose(detector.score(counts.numpy().astype(np.int16)), expected, atol=1e-5)
