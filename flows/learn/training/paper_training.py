"""Training of the paper's networks on windows by the paper's recipe (its section V)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.learning_curve import Check, best
from operators.checks import check_at_least, check_choice

if TYPE_CHECKING:
    import torch

    from flows.learn.training.paper_networks import Network
    from flows.learn.training.training_windows import Windows

Arrays: TypeAlias = dict[str, NDArray[Any]]
Step: TypeAlias = Callable[[int, int], object]

WINDOWED: Final = ("frequency_cnn", "frequency_cnn_interleaved", "paper_tcn")
_BLOCK: Final = 1024  # windows evaluated at once
_ADAM_EPSILON: Final = 1e-7  # Keras's


@dataclass(frozen=True, slots=True)
class PaperRecipe:
    """Settings of the paper's training: Adam, cross-entropy, augmentation.

    Each epoch uses all windows of the smaller class and as many random windows of the other. A window is
    flipped or turned by at most one of the three symmetries of the pad.
    """

    rate: float = 0.002  # learning rate
    clip: float = 1.0  # maximum norm of the gradient of one array
    batch: int = 256  # windows
    dropout: float = 0.2  # probability
    mirror: float = 0.25  # probability of each: x flip, y flip, turn by 180 degrees
    noise: float = 0.5  # counts, standard deviation


_PAPER: Final = PaperRecipe()


def train_windowed(
    name: str,
    train: Sequence[LabelledRecording],
    validation: Sequence[LabelledRecording],
    *,
    seed: int,
    epochs: int,
    recipe: PaperRecipe = _PAPER,
    progress: Callable[[Check], object] = lambda _epoch: None,
    step: Step = lambda _done, _all: None,
) -> tuple[Arrays, list[Check]]:
    """Train one of the paper's networks; keep the epoch with the best balanced accuracy on validation.

    Args:
        name: One of `WINDOWED`.
        train: Recordings of the train split; their counts also determine the standardisation.
        validation: Recordings that choose the epoch.
        seed: Random seed.
        epochs: Number of epochs.
        recipe: Course of the training.
        progress: Called after each epoch.
        step: Called after each step with the number of steps done and of all steps in the epoch.

    Returns:
        Weights for the detector of this name, and the check of each epoch.

    Raises:
        ParameterError: if there is no such network, or `epochs` is below 1.
        InputError: if the recordings of a split have no slip or no static samples.
    """
    import torch  # noqa: PLC0415 - an extra, and slow to import

    from flows.learn.training.training_windows import Windows  # noqa: PLC0415 - imports torch

    check_choice("train_windowed", "name", name, WINDOWED)
    check_at_least("train_windowed", "epochs", epochs, 1)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    windows, unseen = Windows.of(train, device), Windows.of(validation, device)
    rng, generator = np.random.default_rng(seed), torch.Generator(device).manual_seed(seed)
    network = _network(name, windows, recipe, generator)
    optimizer = torch.optim.Adam(network.parameters(), recipe.rate, eps=_ADAM_EPSILON, foreach=True)
    began, curve, weights = perf_counter(), list[Check](), Arrays()
    for number in range(1, epochs + 1):
        loss = _epoch(network, optimizer, windows, recipe, rng=rng, generator=generator, step=step)
        check = Check(number, perf_counter() - began, loss, *_evaluate(network, unseen))
        curve.append(check)
        if best(curve) is check:
            weights = network.arrays()
        progress(check)
    return weights, curve


def _network(name: str, windows: "Windows", recipe: PaperRecipe, generator: "torch.Generator") -> "Network":
    from flows.learn.training.paper_networks import FrequencyCnnNetwork, PaperTcnNetwork  # noqa: PLC0415 - torch

    mean, std = windows.spread()
    with generator.device:  # its random numbers are drawn there
        network: Network
        if name == "paper_tcn":
            network = PaperTcnNetwork(mean, std, dropout=recipe.dropout, generator=generator)
        else:
            interleaved = name == "frequency_cnn_interleaved"
            network = FrequencyCnnNetwork(
                mean, std, interleaved=interleaved, dropout=recipe.dropout, generator=generator
            )
    return network.to(generator.device)


def _epoch(
    network: "Network",
    optimizer: "torch.optim.Optimizer",
    windows: "Windows",
    recipe: PaperRecipe,
    *,
    rng: np.random.Generator,
    generator: "torch.Generator",
    step: Step,
) -> float:
    """Train on as many windows of slip as of static; return the mean loss in nats."""
    import torch  # noqa: PLC0415

    from flows.learn.training.training_windows import varied  # noqa: PLC0415

    network.train()
    device, parameters = generator.device, list(network.parameters())
    picked = windows.balanced(rng)
    slip = torch.as_tensor(windows.slip[picked].astype(np.int64), device=device)
    steps = max(len(picked) // recipe.batch, 1)  # an incomplete batch is left out
    total = torch.zeros((), device=device)
    for number in range(steps):
        rows = slice(number * recipe.batch, (number + 1) * recipe.batch)
        counts = windows.take(picked[rows])
        counts = varied(counts, mirror=recipe.mirror, noise=recipe.noise, rng=rng, generator=generator)
        loss = torch.nn.functional.cross_entropy(network(counts), slip[rows])
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        for parameter in parameters:
            torch.nn.utils.clip_grad_norm_(parameter, recipe.clip)  # each array by itself, as Keras does
        optimizer.step()
        total += loss.detach()
        step(number + 1, steps)
    return total.item() / steps


def _evaluate(network: "Network", windows: "Windows") -> tuple[float, float]:
    """Return accuracy and balanced accuracy of a network on windows, %."""
    import torch  # noqa: PLC0415

    network.eval()
    blocks = np.split(np.arange(len(windows)), range(_BLOCK, len(windows), _BLOCK))
    with torch.inference_mode():
        predicted = torch.cat([network(windows.take(block)).argmax(1) for block in blocks])
    right = predicted.cpu().numpy() == windows.slip
    balanced = (right[windows.slip].mean() + right[~windows.slip].mean()) / 2
    return 100 * float(right.mean()), 100 * float(balanced)
