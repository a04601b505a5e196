import numpy as np
import pytest

from flows.learn.chart.chart_points import Goal, Point, with_front
from flows.learn.evaluation.judgement import Judgement


def point(name: str, us: float, accuracy: float, onset_ms: float = 30.0) -> Point:
    return Point(name, us, 64 * us, streams=True, judged=Judgement(accuracy, accuracy, 1.0, 2.0, onset_ms))


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


def test_equals_do_not_push_each_other_off_the_front() -> None:
    assert front(point("one", 1, 90), point("twin", 1, 90)) == {"one", "twin"}


def test_points_keep_their_order_and_numbers() -> None:
    known = [point("slow", 20, 90), point("fast", 1, 95)]
    assert [(each.name, each.us) for each in with_front(known)] == [("slow", 20), ("fast", 1)]


def test_64_fingertips_at_100_hz_are_a_share_of_a_core() -> None:
    assert point("one", us=3.125, accuracy=90).core_64 == pytest.approx(2.0)  # 200 us each 10 ms


def test_a_point_for_a_program_has_null_where_there_is_no_number() -> None:
    told = point("deaf", 1, 50, onset_ms=np.nan).json()
    assert told["onset_ms"] is None
    assert (told["name"], told["us"], told["accuracy"], told["balanced"]) == ("deaf", 1, 50, 50)
    assert {"false_alarms_per_min", "missed", "pareto"} <= told.keys()


@pytest.mark.parametrize(
    ("reached", "at_least", "met"), [(3, True, True), (1, True, False), (1, False, True)]
)
def test_a_goal_is_met_from_the_side_that_it_says(reached: float, at_least: bool, met: bool) -> None:  # noqa: FBT001
    assert Goal("any", 2, reached, at_least=at_least).met is met
