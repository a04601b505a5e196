import numpy as np

from tests.scene.scene_statistics import Published


def test_a_statistic_inside_the_published_range_has_no_distance() -> None:
    row = Published("x", "x", (2.0,), (4.0,))
    assert [row.distance(np.array([value])) for value in (1.0, 2.0, 3.0, 4.0, 7.0)] == [1 / 3, 0, 0, 0, 1]
