import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from operators.rotation import compose, quaternion, rotate, rotation_difference

angles = st.floats(-4, 4)
vectors = st.tuples(angles, angles, angles)


@given(rotation=vectors, vector=vectors)
def test_a_vector_turns_as_scipy_turns_it(
    rotation: tuple[float, float, float], vector: tuple[float, float, float]
) -> None:
    expected = Rotation.from_rotvec(rotation).apply(vector)
    np.testing.assert_allclose(rotate(vector, quaternion(rotation)), expected, atol=1e-14)


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
