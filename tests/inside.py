"""Looking into objects whose parts are nobody else's business."""

from typing import Any


def inside(owner: object, *names: str) -> Any:  # noqa: ANN401 - whatever it is
    """A private part of an object, or a part of that one."""
    for name in names:
        owner = vars(owner)[name]
    return owner
