"""The loops of operators as plain Python, as where numba is not installed."""

import sys

import pytest


def use_plain_loops(patch: pytest.MonkeyPatch) -> None:
    """Replace each compiled loop of the operators by its Python function, until the patch is undone."""
    for name, module in list(sys.modules.items()):
        if name.startswith("operators.") and not name.startswith("operators.detectors"):
            for key, value in list(vars(module).items()):
                if hasattr(value, "__wrapped__"):
                    patch.setattr(module, key, value.__wrapped__)
