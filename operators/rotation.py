"""Rotation vectors: the direction is the axis, the length the angle in rad.

The functions use `math` only, so that compiled steps can call them and give the same bits.
"""

from math import atan2, cos, inf, nan, sin, sqrt
from typing import Final, TypeAlias

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]  # w, x, y, z; of unit length

_TINY: Final = 1e-300  # added to angles, to avoid a division by zero


def quaternion(rotation: Vector) -> Quaternion:
    """Return the unit quaternion of a rotation vector; NaN if it is not finite."""
    x, y, z = rotation
    half = sqrt(x * x + y * y + z * z) / 2 + _TINY
    if not half < inf:
        return nan, nan, nan, nan
    scale = sin(half) / half / 2
    return cos(half), scale * x, scale * y, scale * z


def rotate(vector: Vector, by: Quaternion) -> Vector:
    """Rotate a vector.

    >>> rotate((0.0, 0.0, 1.0), quaternion((3.141592653589793 / 2, 0.0, 0.0)))
    (0.0, -1.0, 2.220446049250313e-16)
    """
    w, x, y, z = by
    a, b, c = vector
    u, v, t = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return a + w * u + (y * t - z * v), b + w * v + (z * u - x * t), c + w * t + (x * v - y * u)


def compose(first: Vector, by: Vector) -> Vector:
    """Return the rotation vector of `first` followed by `by`, both in the base frame.

    >>> compose((0.0, 0.0, 1.0), by=(0.0, 0.0, 1.0))
    (0.0, 0.0, 2.0)
    """
    return _vector(_product(quaternion(by), quaternion(first)))


def rotation_difference(first: Vector, second: Vector) -> Vector:
    """Return the shortest rotation, in the base frame, from `first` to `second`.

    >>> rotation_difference((0.0, 0.0, 1.5), (0.0, 0.0, 1.0))
    (0.0, 0.0, -0.5)
    """
    w, x, y, z = quaternion(first)
    return _vector(_product(quaternion(second), (w, -x, -y, -z)))


def _product(p: Quaternion, q: Quaternion) -> Quaternion:
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def _vector(q: Quaternion) -> Vector:
    w, x, y, z = q
    sine = sqrt(x * x + y * y + z * z) + _TINY
    angle = 2 * atan2(sine, abs(w)) * (1.0 if w >= 0 else -1.0)  # q and -q are one rotation
    scale = angle / sine
    return scale * x, scale * y, scale * z
