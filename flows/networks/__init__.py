"""Our network as a torch module and as an ONNX file, and the recipe by which it is trained."""

from flows.networks.recipe import Augmentation, Recipe

__all__ = ["Augmentation", "Recipe"]
