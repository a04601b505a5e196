from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional

from flows.learn.training.paper_networks import PaperNetwork, PaperTcnNetwork, paper_network
from flows.learn.training.recipe import PaperRecipe
from flows.learn.training.trained_model import Arrays
from operators.detectors import Detector, PaperTcn
from operators.detectors.frequency_cnn import FrequencyCnn, InterleavedFrequencyCnn

DETECTORS: dict[str, Callable[[Arrays], Detector]] = {
    "frequency_cnn": FrequencyCnn,
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


def _whole(network: PaperTcnNetwork, inputs: Tensor) -> Tensor:
    """Logits (n, 2) of standardised counts (n, steps, 6), by dilated convolutions at every step."""
    values = inputs.transpose(1, 2)  # (n, channels, steps)
    for block in range(4):
        residual = network.match(inputs).transpose(1, 2) if block == 0 else values
        for layer in (2 * block, 2 * block + 1):
            kernel = network.get_parameter(f"convolutions.{layer}.weight")[:, :, 0]
            bias = network.get_parameter(f"convolutions.{layer}.bias")
            padded = functional.pad(values, (7 * 2**block, 0))
            values = functional.conv1d(padded, kernel, bias, dilation=2**block)
            values = functional.selu(network.norms[layer](values.transpose(1, 2))).transpose(1, 2)
        values = functional.selu(residual + values)
    last = values[:, :, -1]
    for dense, norm in zip(network.dense, network.dense_norms, strict=True):
        last = functional.selu(norm(dense(last)))
    logits: Tensor = network.out(last)
    return logits


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


@every
def test_it_has_as_many_parameters_as_the_papers(name: str) -> None:
    expected = 10_070 if name == "paper_tcn" else 29_782
    parameters = _network(name, torch.Generator()).parameters()
    assert sum(each.numel() for each in parameters) == expected


def test_the_steps_that_the_tcn_leaves_out_change_nothing() -> None:
    generator = torch.Generator().manual_seed(1)
    network, inputs = _paper_tcn(generator), torch.randn(30, 100, 6, generator=generator)
    inputs.requires_grad_()
    logits, whole = network.logits(inputs), _whole(network, inputs)
    torch.testing.assert_close(logits, whole, atol=1e-5, rtol=0)
    parameters = [inputs, *network.parameters()]
    for found, expected in zip(
        torch.autograd.grad(logits.square().sum(), parameters),
        torch.autograd.grad(whole.square().sum(), parameters),
        strict=True,
    ):
        torch.testing.assert_close(found, expected, atol=1e-3, rtol=1e-3)


def _paper_tcn(generator: torch.Generator) -> PaperTcnNetwork:
    network = _network("paper_tcn", generator)
    assert isinstance(network, PaperTcnNetwork)
    return network
