"""The paper's networks, trained on windows by the paper's recipe."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from flows.learn.labelled_recordings import LabelledRecording
from operators.errors import ParameterError

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
    """How the paper trains its networks: Adam, cross-entropy, augmentation.

    Each epoch takes all windows of the smaller class and as many of the other, drawn anew. The three motions
    that map the pad onto itself exclude each other.
    """

    rate: float = 0.002  # learning rate
    clip: float = 1.0  # the longest gradient of one array
    batch: int = 256  # windows
    dropout: float = 0.2  # probability
    mirror: float = 0.25  # probability of an x flip, the same of a y flip, and of a turn by 180 degrees
    noise: float = 0.5  # counts, standard deviation


@dataclass(frozen=True, slots=True)
class Epoch:
    """What one epoch of training came to."""

    number: int  # from 1
    loss: float  # nats, mean over its windows
    accuracy: float  # share of the validation windows that is judged rightly
    balanced: float  # mean of that share among slip and among static


_PAPER: Final = PaperRecipe()


def train_windowed(
    name: str,
    train: Sequence[LabelledRecording],
    validation: Sequence[LabelledRecording],
    *,
    seed: int,
    epochs: int,
    recipe: PaperRecipe = _PAPER,
    progress: Callable[[Epoch], object] = lambda _epoch: None,
    step: Step = lambda _done, _all: None,
) -> tuple[Arrays, list[Epoch]]:
    """Train one of the paper's networks, and keep the epoch of the best balanced accuracy on validation.

    Args:
        name: one of `WINDOWED`
        train: recordings to learn from; their counts also give the standardisation
        validation: other recordings, to choose the epoch by
        seed: of the first weights and of all that is drawn at random
        epochs: how many
        recipe: how
        progress: called after each epoch
        step: called after each step, with how many of its epoch are done and how many there are

    Returns:
        the arrays that the detector of this name takes, and every epoch

    Raises:
        ParameterError: there is no such network, or not one epoch.
        InputError: the recordings of a split hold no slip, or nothing else.
    """
    if epochs < 1:
        raise ParameterError("train_windowed", "epochs", epochs, "at least 1")
    best, weights, history = -1.0, Arrays(), list[Epoch]()
    endless = windowed_epochs(name, train, validation, seed=seed, recipe=recipe, step=step)
    for epoch, arrays in islice(endless, epochs):
        history.append(epoch)
        if epoch.balanced > best:
            best, weights = epoch.balanced, arrays()
        progress(epoch)
    return weights, history


def windowed_epochs(
    name: str,
    train: Sequence[LabelledRecording],
    validation: Sequence[LabelledRecording],
    *,
    seed: int,
    recipe: PaperRecipe = _PAPER,
    step: Step = lambda _done, _all: None,
) -> Iterator[tuple[Epoch, Callable[[], Arrays]]]:
    """The same without an end: each epoch, with what gives the weights as they are after it."""
    import torch  # noqa: PLC0415 - an extra, and slow to import

    from flows.learn.training.training_windows import Windows  # noqa: PLC0415 - torch

    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    windows, unseen = Windows.of(train, device), Windows.of(validation, device)
    rng, generator = np.random.default_rng(seed), torch.Generator(device).manual_seed(seed)
    network = _network(name, windows, recipe, generator)
    optimizer = torch.optim.Adam(network.parameters(), recipe.rate, eps=_ADAM_EPSILON, foreach=True)
    number = 0
    while True:
        number += 1
        loss = _epoch(network, optimizer, windows, recipe, rng=rng, generator=generator, step=step)
        accuracy, balanced = _evaluate(network, unseen)
        yield Epoch(number, loss, accuracy, balanced), network.arrays


def _network(name: str, windows: "Windows", recipe: PaperRecipe, generator: "torch.Generator") -> "Network":
    from flows.learn.training.paper_networks import FrequencyCnnNetwork, PaperTcnNetwork  # noqa: PLC0415 - torch

    if name not in WINDOWED:
        raise ParameterError("train_windowed", "name", name, f"one of {', '.join(WINDOWED)}")
    mean, std = windows.spread()
    with generator.device:  # what it draws must lie there
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
    """One pass over as many windows of slip as of static; the mean loss in nats."""
    import torch  # noqa: PLC0415

    from flows.learn.training.training_windows import varied  # noqa: PLC0415

    network.train()
    device, parameters = generator.device, list(network.parameters())
    picked = windows.balanced(rng)
    slip = torch.as_tensor(windows.slip[picked].astype(np.int64), device=device)
    steps = max(len(picked) // recipe.batch, 1)  # what is left over is drawn again some other time
    total = torch.zeros((), device=device)
    for number in range(steps):
        rows = slice(number * recipe.batch, (number + 1) * recipe.batch)
        counts = windows.take(picked[rows])
        counts = varied(counts, mirror=recipe.mirror, noise=recipe.noise, rng=rng, generator=generator)
        loss = torch.nn.functional.cross_entropy(network(counts), slip[rows])
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        for parameter in parameters:
            torch.nn.utils.clip_grad_norm_(parameter, recipe.clip)  # each by itself, as Keras does
        optimizer.step()
        total += loss.detach()
        step(number + 1, steps)
    return total.item() / steps


def _evaluate(network: "Network", windows: "Windows") -> tuple[float, float]:
    """Accuracy, and balanced accuracy, of a network on windows."""
    import torch  # noqa: PLC0415

    network.eval()
    blocks = np.split(np.arange(len(windows)), range(_BLOCK, len(windows), _BLOCK))
    with torch.inference_mode():
        called = torch.cat([network(windows.take(block)).argmax(1) for block in blocks])
    right = called.cpu().numpy() == windows.slip
    return float(right.mean()), float((right[windows.slip].mean() + right[~windows.slip].mean()) / 2)
