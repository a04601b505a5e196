"""Rotations of the pose's rotation vector: its direction is the axis, its length the angle in rad.

Written by component, so that one row as floats and many rows as arrays take the same steps and agree bit
for bit. Elementwise sine and cosine are numpy's in both.
"""

from math import sqrt
from typing import Any, Final, TypeAlias, TypeVar

import numpy as np

from operators.batch import Reals

Real = TypeVar("Real", float, Reals)  # one value, or (n,) of them
Vector: TypeAlias = tuple[Real, Real, Real]
Quaternion: TypeAlias = tuple[Real, Real, Real, Real]  # w, x, y, z; of unit length

_TINY: Final = 1e-300  # no rotation is a rotation by almost nothing: saves a division by zero


def quaternion(rotation: Vector[Real]) -> Quaternion[Real]:
    """The unit quaternion of a rotation vector."""
    x, y, z = rotation
    half = root(x * x + y * y + z * z) / 2 + _TINY
    scale = _each(np.sin, half) / half / 2
    return _each(np.cos, half), scale * x, scale * y, scale * z


def turn(vector: tuple[float, float, float], by: Quaternion[Real]) -> Vector[Real]:
    """A fixed vector, turned.

    >>> turn((0.0, 0.0, 1.0), quaternion((np.pi / 2, 0.0, 0.0)))
    (0.0, -1.0, 2.220446049250313e-16)
    """
    w, x, y, z = by
    a, b, c = vector
    u, v, t = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return a + w * u + (y * t - z * v), b + w * v + (z * u - x * t), c + w * t + (x * v - y * u)


def between(first: Vector[Real], second: Vector[Real], part: Real) -> Vector[Real]:
    """The rotation vector a part (0 to 1) of the shortest way from one rotation to another.

    Its length is pi at most; it is NaN where either is not finite.

    >>> between((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.25)
    (0.0, 0.25, 0.0)
    """
    start = w, x, y, z = quaternion(first)
    a, b, c = _vector(_product((w, -x, -y, -z), quaternion(second)))
    return _vector(_product(start, quaternion((part * a, part * b, part * c))))


def turned(first: Vector[Real], by: Vector[Real]) -> Vector[Real]:
    """The rotation vector of a rotation and then another, both in the base frame.

    >>> turned((0.0, 0.0, 1.0), by=(0.0, 0.0, 1.0))
    (0.0, 0.0, 2.0)
    """
    return _vector(_product(quaternion(by), quaternion(first)))


def onward(first: Vector[Real], second: Vector[Real]) -> Vector[Real]:
    """The rotation vector, in the base frame, that turns one rotation into another the shortest way.

    >>> onward((0.0, 0.0, 1.5), (0.0, 0.0, 1.0))
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
    sine = root(x * x + y * y + z * z) + _TINY
    angle = 2 * _each(np.arctan2, sine, abs(w)) * (1.0 - 2.0 * (w < 0))  # q and -q are one rotation
    scale = angle / sine
    return scale * x, scale * y, scale * z


def root(value: Real) -> Real:
    """The square root."""
    if isinstance(value, float):
        return sqrt(value)
    return _each(np.sqrt, value)


def _each(function: np.ufunc, *values: Real) -> Real:
    """A function of numpy's; of floats it gives a float, on which arithmetic is fast."""
    found: Any = function(*values)
    result: Real = found if found.ndim else found.item()
    return result
