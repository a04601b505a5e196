import math

import numpy as np
import pytest

from flows.lab.collection.arm_path import (
    Extent,
    Line,
    Pose,
    Slide,
    Step,
    Tare,
    Touchdown,
    Trace,
    Wait,
    beside,
    heading,
    raised,
    shifted,
)
from operators.rotation import onward

START: Pose = (0.4, 0.1, 0.2, math.pi, 0.0, 0.0)  # looks down


def test_a_line_lasts_as_long_as_its_trapezoid_of_speed() -> None:
    assert Line((0.5, 0.1, 0.2, math.pi, 0, 0), 0.1, 0.5).seconds(START) == pytest.approx(1.0 + 0.2)


def test_a_line_too_short_for_its_speed_is_a_triangle() -> None:
    assert Line((0.402, 0.1, 0.2, math.pi, 0, 0), 0.1, 0.5).seconds(START) == pytest.approx(
        2 * math.sqrt(0.002 / 0.5)
    )


def test_a_line_that_only_turns_lasts_as_its_angle_says() -> None:
    turned = beside(START, yaw=0.3)
    assert Line(turned, 0.1, 0.5).seconds(START) == pytest.approx(0.3 / 0.1 + 0.2)


@pytest.mark.parametrize(("time", "angle", "seconds"), [(2.0, 2.0, 3.0), (0.5, 0.25, 1.0)])
def test_a_slide_turns_as_far_as_its_ramps_let_it(time: float, angle: float, seconds: float) -> None:
    slide = Slide(heading(START, (0.0, 0.0, 0.0), 1.0), time, 1.0)
    end = slide.end(START)
    assert math.hypot(*onward(START[3:], end[3:])) == pytest.approx(angle)
    assert slide.seconds(START) == pytest.approx(seconds)
    assert end[:3] == START[:3]


def test_a_slide_goes_as_far_as_its_velocity_for_its_time() -> None:
    end = Slide((0.1, -0.05, 0.0, 0.0, 0.0, 0.0), 0.6, 0.5).end(START)
    np.testing.assert_allclose(end[:3], (0.46, 0.07, 0.2))


def test_an_extent_spans_all_ends_and_adds_all_times() -> None:
    steps = (
        Line((0.5, 0.1, 0.2, math.pi, 0, 0), 0.1, 0.5),
        Wait(0.7),
        Line((0.4, 0, 0.3, math.pi, 0, 0), 1, 10),
    )
    extent = Extent.of(steps, START)
    assert (extent.low, extent.high) == ((0.4, 0.0, 0.2), (0.5, 0.1, 0.3))
    assert extent.end == steps[2].pose
    assert extent.seconds == pytest.approx(1.2 + 0.7 + math.sqrt(0.03) + 0.1)


@pytest.mark.parametrize("pose", [START, (0.1, 0.2, 0.3, 0.5, -1.0, 0.7)])
def test_beside_moves_in_the_frame_of_the_pose(pose: Pose) -> None:
    there = beside(beside(pose, (0.01, -0.02, 0.03)), (-0.01, 0.02, -0.03))
    np.testing.assert_allclose(there, pose, atol=1e-12)
    assert math.dist(pose[:3], beside(pose, (0.01, -0.02, 0.03))[:3]) == pytest.approx(0.0374166, abs=1e-6)


def test_the_fingertip_that_looks_down_sees_up_as_away_from_it() -> None:
    np.testing.assert_allclose(heading(START, (0.0, 0.1, 0.0)), (0, -0.1, 0, 0, 0, 0), atol=1e-12)
    np.testing.assert_allclose(beside(START, (0, 0, 0.05))[:3], (0.4, 0.1, 0.15), atol=1e-12)


def test_what_is_in_the_air_is_not_raised() -> None:
    assert raised((0.4, 0.1, 0.25, math.pi, 0, 0), START, 0.01) == (0.4, 0.1, 0.25, math.pi, 0, 0)
    np.testing.assert_allclose(raised((0.5, 0.1, 0.19, math.pi, 0, 0), START, 0.01)[:3], (0.5, 0.1, 0.21))


def test_a_trace_reaches_as_far_and_lasts_as_long_as_its_places_say() -> None:
    places = ((0.4, 0.1, 0.25), (0.43, 0.14, 0.25), (0.43, 0.14, 0.2))
    trace = Trace(places, 0.1, 0.5)
    assert trace.end(START) == (*places[-1], *START[3:])
    assert trace.seconds(START) == pytest.approx((0.05 + 0.05 + 0.05) / 0.1 + 0.2)
    reach = Extent.of([trace], START)
    assert (reach.low, reach.high) == ((0.4, 0.1, 0.2), (0.43, 0.14, 0.25))


def test_a_touchdown_is_bounded_by_its_way() -> None:
    down = Touchdown((0.0, 0.003, -0.004), 2.0, 0.002, 0.5)
    reach = Extent.of([Tare(0.3), down], START)
    assert reach.low == pytest.approx((0.4, 0.1, 0.196))
    assert reach.seconds == pytest.approx(0.3 + 0.005 / 0.002 + 0.002 / 0.5)


def test_what_a_touchdown_spared_of_its_way_is_told_along_it() -> None:
    down = Touchdown((0.0, 0.003, -0.004), 2.0, 0.002, 0.5)
    there = beside(down.end(START), (0.0002, 0.0, 0.0))  # it drifted aside
    assert down.spared(START, there) == pytest.approx((0.0, 0.0, 0.0))
    assert down.spared(START, START) == pytest.approx((0.0, -0.003, 0.004))


def test_steps_that_lead_elsewhere_are_shifted_and_the_others_left() -> None:
    slide = Slide((0.1, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 0.5)
    steps: list[Step] = [Wait(0.3), Line(START, 0.1, 0.5), Trace((START[:3],), 0.1, 0.5), slide]
    wait, line, trace, slid = shifted(steps, (0.1, 0.0, -0.2))
    assert (wait, slid) == (steps[0], slide)
    np.testing.assert_allclose(line.end(START), (0.5, 0.1, 0.0, math.pi, 0, 0), atol=1e-12)
    np.testing.assert_allclose(trace.end(START), (0.5, 0.1, 0.0, math.pi, 0, 0), atol=1e-12)
