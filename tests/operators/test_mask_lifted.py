import math

import numpy as np

from operators import SLIP, STATIC, UNKNOWN, Labelled, MaskLifted

PLACE = (0.4, 0.0, 0.1, math.pi, 0.0, 0.0)  # looks down


def labelled(height: list[float], label: list[int]) -> Labelled:
    n = len(height)
    pose = np.tile((0.5, 0.3, 0.0, math.pi, 0.0, 0.0), (n, 1))
    pose[:, 2] = np.array(height)
    counts = np.zeros((n, 6), np.int16)
    return Labelled(
        np.arange(n) * 10,
        counts,
        counts,
        np.ones((n, 6), np.bool_),
        np.zeros((n, 6)),
        pose,
        np.ones(n, np.bool_),
        np.full(n, 0.1),
        np.array(label, np.int8),
        finger=1,
    )


HEIGHTS = [0.0985, 0.1, 0.1019, 0.1021, 0.15, 0.15, math.nan]
LABELS = [SLIP, SLIP, SLIP, SLIP, SLIP, STATIC, SLIP]


def test_only_slip_in_the_air_becomes_unknown() -> None:
    given = MaskLifted(PLACE).push(labelled(HEIGHTS, LABELS))
    assert given.label.tolist() == [SLIP, SLIP, SLIP, UNKNOWN, UNKNOWN, STATIC, SLIP]
    assert given.finger == 1
    np.testing.assert_array_equal(given.pose, labelled(HEIGHTS, LABELS).pose)


def test_a_surface_may_lie_any_way() -> None:
    wall = (0.5, 0.3, 0.1, 0.0, math.pi / 2, 0.0)  # looks along x, away from the base
    batch = labelled([0.1, 0.2], [SLIP, SLIP])  # both at the wall's x
    assert MaskLifted(wall).push(batch).label.tolist() == [SLIP, SLIP]
    away = (0.6, 0.3, 0.1, 0.0, math.pi / 2, 0.0)
    assert MaskLifted(away).push(batch).label.tolist() == [UNKNOWN, UNKNOWN]
