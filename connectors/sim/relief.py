"""The height of a curved surface about its highest point: a sphere, or a cylinder that lies down."""

from math import sqrt


def drop(curvatures: tuple[float, float], x: float, y: float) -> float:
    """How far a surface falls away below its highest point, m.

    Beyond the edge of the body, where there is none, it falls on, so that nothing is touched there.

    Args:
        curvatures: Along x and along y, 1/m: both alike of a sphere, one of them 0 of a cylinder.
        x: From the highest point, m.
        y: The same.

    >>> round(drop((1 / 0.06, 1 / 0.06), 0.03, 0.0), 6)
    0.008038
    >>> drop((0.0, 1 / 0.06), 0.03, 0.0)
    0.0
    """
    across = curvatures[0] * x * x + curvatures[1] * y * y  # m
    return across / (1 + sqrt(max(0.0, 1 - max(curvatures) * across)))
