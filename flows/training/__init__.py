"""How detectors are trained: ours on whole sequences, the paper's on windows by the paper's recipe."""

from flows.training.paper import WINDOWED, Epoch, PaperRecipe, train_windowed, windowed_epochs

__all__ = ["WINDOWED", "Epoch", "PaperRecipe", "train_windowed", "windowed_epochs"]
