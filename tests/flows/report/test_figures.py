"""Names of points in figures."""

from itertools import pairwise

from flows.report.figures import grid, name_points


def heights(points: list[tuple[str, float, float]]) -> list[float]:
    """Return the heights of the names in a panel of 252 points, sorted."""
    _, (axis,) = grid(1, 1, (5, 4))
    axis.set(xlim=(0, 10), ylim=(0, 100))
    name_points(axis, points, (4.6, 3.5))
    return sorted(252 * each.xy[1] / 100 + each.xyann[1] for each in axis.texts)


def test_names_of_points_at_the_lower_edge_stay_inside_the_panel_and_apart() -> None:
    found = heights([(f"detector {number}", number / 10, 2.0) for number in range(15)])
    assert found[0] > 0
    assert all(upper - lower >= 11.9 for lower, upper in pairwise(found))
