import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from operators.rotation import compose, interpolate_rotation, quaternion, rotate, rotation_difference

angles = st.floats(-4, 4)
vectors = st.tuples(angles, angles, angles)
parts = st.floats(0, 1)


@given(rotation=vectors, vector=vectors)
def test_a_vector_turns_as_scipy_turns_it(
    rotation: tuple[float, float, float], vector: tuple[float, float, float]
) -> None:
    expected = Rotation.from_rotvec(rotation).apply(vector)
    np.testing.assert_allclose(rotate(vector, quaternion(rotation)), expected, atol=1e-14)


@given(first=vectors, second=vectors, part=parts)
def test_interpolation_of_rotations_equals_scipys_slerp(
    first: tuple[float, float, float], second: tuple[float, float, float], part: float
) -> None:
    ends = Rotation.from_rotvec([first, second])
    if (ends[0].inv() * ends[1]).magnitude() > 3.14:
        return  # half a turn apart, either way is as short
    found = Rotation.from_rotvec(interpolate_rotation(first, second, part))
    assert (found.inv() * Slerp([0, 1], ends)(part)).magnitude() < 1e-7


@given(first=vectors, second=vectors)
def test_a_rotation_and_the_difference_compose_to_the_other(
    first: tuple[float, float, float], second: tuple[float, float, float]
) -> None:
    both = Rotation.from_rotvec(compose(first, by=second))
    assert (both.inv() * Rotation.from_rotvec(second) * Rotation.from_rotvec(first)).magnitude() < 1e-7
    way = rotation_difference(first, second)
    assert np.linalg.norm(way) < np.pi + 1e-9
    end = Rotation.from_rotvec(compose(first, by=way))
    assert (end.inv() * Rotation.from_rotvec(second)).magnitude() < 1e-7
