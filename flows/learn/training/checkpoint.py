"""Going on where training stopped: a safetensors file, never a pickle."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from flows.learn.training.learning_curve import Check
from flows.learn.training.recipe import Recipe
from operators.errors import InputError
from storage import load_weights, save_weights

if TYPE_CHECKING:
    from flows.learn.training.tcn_module import DenseTcn


class Checkpoint:
    """The state of a training run in a file; without a path, nothing is kept.

    Args:
        path: Ends in .safetensors.
        recipe: Of the run; a checkpoint of another one is refused.
        network: What is trained.
        optimiser: What trains it.
    """

    def __init__(
        self, path: Path | None, recipe: Recipe, network: "DenseTcn", optimiser: torch.optim.Optimizer
    ) -> None:
        self.path = path
        self.best: Mapping[str, NDArray[Any]] = {}
        self._recipe = json.dumps(asdict(recipe), sort_keys=True, default=list)
        self._network, self._optimiser = network, optimiser

    def resume(self) -> tuple[list[Check], int, float]:
        """Take up the state that was kept: the checks so far, the steps done, the seconds they took.

        Raises:
            InputError: if it is damaged, or of another recipe.
        """
        if self.path is None or not self.path.exists():
            return [], 0, 0.0
        arrays, about = load_weights(self.path)
        if about.get("recipe") != self._recipe:
            raise InputError(str(self.path), "is of training with other settings; remove it to start anew")
        state = json.loads(about["state"])
        tensors = {name: torch.as_tensor(array) for name, array in arrays.items()}
        self._network.load_state_dict(_under(tensors, "network/"))
        moments = {
            index: {key: tensors[f"optimiser/{index}/{key}"] for key in ("step", "exp_avg", "exp_avg_sq")}
            for index in range(len(list(self._network.parameters())))
        }
        self._optimiser.load_state_dict({**self._optimiser.state_dict(), "state": moments})
        self.best = _under(arrays, "best/")
        return [Check(**check) for check in state["curve"]], state["step"], state["seconds"]

    def save(self, curve: list[Check], step: int, seconds: float, best: Mapping[str, NDArray[Any]]) -> None:
        """Keep the state, whole or not at all."""
        if self.path is None:
            return
        self.best = best
        arrays: dict[str, NDArray[Any]] = {f"best/{name}": array for name, array in best.items()}
        for name, tensor in self._network.state_dict().items():
            arrays[f"network/{name}"] = tensor.cpu().numpy()
        for index, moments in self._optimiser.state_dict()["state"].items():
            for key, tensor in moments.items():
                arrays[f"optimiser/{index}/{key}"] = np.asarray(tensor.cpu().numpy())
        state = {"curve": [asdict(check) for check in curve], "step": step, "seconds": seconds}
        save_weights(self.path, arrays, {"recipe": self._recipe, "state": json.dumps(state)})

    def remove(self) -> None:
        """Forget it: training ended."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def _under(named: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    return {name.removeprefix(prefix): value for name, value in named.items() if name.startswith(prefix)}
