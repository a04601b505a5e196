"""Rotation vectors: the direction is the axis, the length the angle in rad.

The functions take components, as floats for one row or as arrays for many rows; both give identical bits.
"""

from math import sqrt
from typing import Any, Final, TypeAlias, TypeVar

import numpy as np

from operators.batch import Reals

Real = TypeVar("Real", float, Reals)  # one value, or (n,) of them
Vector: TypeAlias = tuple[Real, Real, Real]
Quaternion: TypeAlias = tuple[Real, Real, Real, Real]  # w, x, y, z; of unit length

_TINY: Final = 1e-300  # added to angles, to avoid a division by zero


def quaternion(rotation: Vector[Real]) -> Quaternion[Real]:
    """Return the unit quaternion of a rotation vector."""
    x, y, z = rotation
    half = square_root(x * x + y * y + z * z) / 2 + _TINY
    scale = _each(np.sin, half) / half / 2
    return _each(np.cos, half), scale * x, scale * y, scale * z


def rotate(vector: tuple[float, float, float], by: Quaternion[Real]) -> Vector[Real]:
    """Rotate a constant vector.

    >>> rotate((0.0, 0.0, 1.0), quaternion((np.pi / 2, 0.0, 0.0)))
    (0.0, -1.0, 2.220446049250313e-16)
    """
    w, x, y, z = by
    a, b, c = vector
    u, v, t = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return a + w * u + (y * t - z * v), b + w * v + (z * u - x * t), c + w * t + (x * v - y * u)


def interpolate_rotation(first: Vector[Real], second: Vector[Real], fraction: Real) -> Vector[Real]:
    """Interpolate between two rotations along the shortest path.

    Args:
        first: Rotation vector at `fraction` 0.
        second: Rotation vector at `fraction` 1.
        fraction: Position on the path, 0 to 1.

    Returns:
        Rotation vector of length pi at most; NaN if an input is not finite.

    >>> interpolate_rotation((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.25)
    (0.0, 0.25, 0.0)
    """
    start = w, x, y, z = quaternion(first)
    a, b, c = _vector(_product((w, -x, -y, -z), quaternion(second)))
    return _vector(_product(start, quaternion((fraction * a, fraction * b, fraction * c))))


def compose(first: Vector[Real], by: Vector[Real]) -> Vector[Real]:
    """Return the rotation vector of `first` followed by `by`, both in the base frame.

    >>> compose((0.0, 0.0, 1.0), by=(0.0, 0.0, 1.0))
    (0.0, 0.0, 2.0)
    """
    return _vector(_product(quaternion(by), quaternion(first)))


def rotation_difference(first: Vector[Real], second: Vector[Real]) -> Vector[Real]:
    """Return the shortest rotation, in the base frame, from `first` to `second`.

    >>> rotation_difference((0.0, 0.0, 1.5), (0.0, 0.0, 1.0))
    (0.0, 0.0, -0.5)
    """
    w, x, y, z = quaternion(first)
    return _vector(_product(quaternion(second), (w, -x, -y, -z)))


def _product(p: Quaternion[Real], q: Quaternion[Real]) -> Quaternion[Real]:
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def _vector(q: Quaternion[Real]) -> Vector[Real]:
    w, x, y, z = q
    sine = square_root(x * x + y * y + z * z) + _TINY
    angle = 2 * _each(np.arctan2, sine, abs(w)) * (1.0 - 2.0 * (w < 0))  # q and -q are one rotation
    scale = angle / sine
    return scale * x, scale * y, scale * z


def square_root(value: Real) -> Real:
    """Return the square root."""
    if isinstance(value, float):
        return sqrt(value)
    return _each(np.sqrt, value)


def _each(function: np.ufunc, *values: Real) -> Real:
    """Apply a numpy function; return Python floats for floats, since their arithmetic is faster."""
    found: Any = function(*values)
    result: Real = found if found.ndim else found.item()
    return result
