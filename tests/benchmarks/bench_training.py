"""What one label costs in training: dense crops against windows, the same network, by turns."""

from argparse import ArgumentParser
from collections.abc import Callable
from platform import machine, python_version
from statistics import median
from time import process_time

import torch
from torch import Tensor

from flows.learn.training.recipe import Recipe
from flows.learn.training.tcn_module import DenseTcn
from tests.benchmarks.machine import commit

WINDOWS = 256  # of a batch, as the paper has it
SAMPLES = 266_000  # of the paper's plan: labels of one epoch


def step(
    network: DenseTcn, optimiser: torch.optim.Optimizer, counts: Tensor, first: int
) -> Callable[[], None]:
    """One step of training on (b, 6, n) counts, the labels from sample `first` on."""
    network.train()

    def run() -> None:
        logit = network(counts)[:, first:]
        loss = torch.nn.functional.binary_cross_entropy_with_logits(logit, torch.ones_like(logit))
        optimiser.zero_grad()
        torch.autograd.backward(loss)
        optimiser.step()

    return run


def main() -> None:
    """Measure and print the table."""
    options = ArgumentParser(description=__doc__)
    options.add_argument("--turns", type=int, default=7)
    given = options.parse_args()
    torch.set_num_threads(1)
    recipe = Recipe()
    field = recipe.receptive_field
    shapes = {"dense": (recipe.batch, recipe.crop), "windowed": (WINDOWS, field)}
    steps: dict[str, Callable[[], None]] = {}
    for name, (b, n) in shapes.items():
        network = DenseTcn(recipe)
        optimiser = torch.optim.AdamW(network.parameters())
        steps[name] = step(network, optimiser, 100 * torch.randn(b, 6, n), field - 1)
    labels = {name: b * (n - field + 1) for name, (b, n) in shapes.items()}
    spent: dict[str, list[float]] = {name: [] for name in steps}
    for turn in range(given.turns + 1):
        for name, run in steps.items():
            begin = process_time()
            run()
            if turn:  # the first one warms up
                spent[name].append((process_time() - begin) / labels[name])
    print(f"seed none, medians of {given.turns} turns, one thread, commit {commit()}")
    print(f"{machine()}, Python {python_version()}, torch {torch.__version__}, {recipe.filters} filters")
    print(f"{'':10} {'us/label':>10} {'s/epoch of the plan':>20}")
    for name, values in spent.items():
        print(f"{name:10} {1e6 * median(values):10.1f} {SAMPLES * median(values):20.1f}")
    ratio = median(w / d for w, d in zip(spent["windowed"], spent["dense"], strict=True))
    print(f"windowed : dense {ratio:.0f}")


if __name__ == "__main__":
    main()
