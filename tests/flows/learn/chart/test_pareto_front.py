import pytest

from flows.learn.chart.chart_study import Point, with_front
from flows.learn.evaluation.event_metrics import Performance


def point(name: str, us: float, accuracy: float, onset_ms: float = 30.0) -> Point:
    performance = Performance(accuracy, accuracy, 1.0, 2.0, onset_ms, 0.0)
    return Point(name, us, 64 * us, streams=True, performances={"arm-speed": performance})


def front(*points: Point) -> set[str]:
    return {each.name for each in with_front(points) if each.pareto}


def test_the_front_of_a_known_set() -> None:
    known = [
        point("fast", 1, 80),
        point("slower but better", 2, 90),
        point("dominated", 3, 85),
        point("best", 10, 95),
        point("slow", 20, 95),
        point("as fast as the best but worse", 10, 94),
    ]
    assert front(*known) == {"fast", "slower but better", "best"}


def test_equal_points_are_both_on_the_front() -> None:
    assert front(point("one", 1, 90), point("twin", 1, 90)) == {"one", "twin"}


def test_points_keep_their_order_and_numbers() -> None:
    known = [point("slow", 20, 90), point("fast", 1, 95)]
    assert [(each.name, each.us) for each in with_front(known)] == [("slow", 20), ("fast", 1)]


def test_64_fingertips_at_100_hz_are_a_share_of_a_core() -> None:
    assert point("one", us=3.125, accuracy=90).core_64 == pytest.approx(2.0)  # 200 us each 10 ms
