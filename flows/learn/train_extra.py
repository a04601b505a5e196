"""The train extra: PyTorch, scikit-learn and ONNX, which are imported on first use."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any, Final

from operators.errors import InputError

_PACKAGES: Final = {"scikit-learn": "sklearn", "torch": "torch", "onnx": "onnx", "onnxruntime": "onnxruntime"}


def require_train_extra(command: str) -> None:
    """Require that the packages of the train extra are installed.

    Raises:
        InputError: if one is missing; the message contains the command that installs them.
    """
    if missing := [name for name, module in _PACKAGES.items() if find_spec(module) is None]:
        raise InputError(command, f"needs {', '.join(missing)}: in the clone, pip install -e '.[train]'")


def sklearn(module: str) -> Any:  # noqa: ANN401 - scikit-learn has no type annotations
    """Import a module of scikit-learn, which takes a second the first time."""
    return import_module(f"sklearn.{module}")
