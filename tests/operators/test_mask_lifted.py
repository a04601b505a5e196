import math
from dataclasses import replace

import numpy as np

from operators import SLIP, STATIC, UNKNOWN, Labelled, MaskLifted

PLACE = (0.4, 0.0, 0.1, math.pi, 0.0, 0.0)  # looks down
HEIGHTS = [0.0985, 0.1, 0.1019, 0.1021, 0.15, 0.15, math.nan]
LABELS = [SLIP, SLIP, SLIP, SLIP, SLIP, STATIC, SLIP]


def labelled(height: list[float], label: list[int]) -> Labelled:
    pose = np.tile((0.5, 0.3, 0.0, math.pi, 0.0, 0.0), (len(height), 1))
    pose[:, 2] = np.array(height)
    return replace(Labelled.zeros(len(height)), pose=pose, label=np.array(label, np.int8), finger=1)


def test_only_slip_in_the_air_becomes_unknown() -> None:
    given = MaskLifted(PLACE).push(labelled(HEIGHTS, LABELS))
    assert given.label.tolist() == [SLIP, SLIP, SLIP, UNKNOWN, UNKNOWN, STATIC, SLIP]
    assert given.finger == 1
    np.testing.assert_array_equal(given.pose, labelled(HEIGHTS, LABELS).pose)
