import pytest

from connectors.sim.arm_motion import Controller
from connectors.sim.finger import Finger
from connectors.sim.paper_plan import PaperPlan
from connectors.sim.scene import PaperStrokes, Parameters, Scene
from flows.learn.evaluation.stress_study import FIELDS, plan_of, stressed
from operators.batch import columns

PLAIN = Scene(PaperStrokes(0.1, 2.0, pause_spread=0.0))
HARD = {
    "noise": 14.0, "gain": 1.3, "offset": 30.0, "drift": 20.0, "dead": 2, "lost": 0.3, "clock": -0.1,
    "vibration": 3e-4, "friction": 0.5, "stick_slip": 0.0, "force": 0.2, "slip_speed": 0.1,
}  # fmt: skip
TOUCHED = {"vibration", "friction", "stick_slip", "force", "lost"}  # change the truth, too


def shown(field: str) -> tuple[str, ...]:
    """Return the streams and truth that a field changes."""
    if field == "slip_speed":
        return "touch", "motion", "truth"
    return ("touch", "truth") if field in TOUCHED else ("touch",)


def recorded(scene: Scene) -> dict[str, bytes]:
    """All bytes of both streams and of the truth."""
    taken, motion = Finger(scene, 3).take(350), Controller(scene, 3).take(430)
    assert taken is not None
    assert motion is not None
    parts = {"touch": taken[0], "motion": motion, "truth": taken[1]}
    return {
        part: b"".join(getattr(batch, name).tobytes() for name in columns(type(batch)))
        for part, batch in parts.items()
    }


@pytest.mark.parametrize("field", FIELDS)
def test_a_field_changes_what_it_should_and_nothing_else(field: str) -> None:
    plain, hard = recorded(PLAIN), recorded(stressed(PLAIN, field, HARD[field]))
    changed = tuple(part for part, recording in plain.items() if hard[part] != recording)
    assert changed == shown(field)
    assert recorded(FIELDS[field].change(PLAIN, FIELDS[field].nominal)) == plain
    for value in FIELDS[field].values[1:]:
        assert stressed(Scene(), field, value) != Scene()


def test_force_and_speed_are_the_plans() -> None:
    def stroke(field: str, value: float) -> tuple[float | None, float]:
        _, approach, first, *_ = (move for _, move in stressed(PLAIN, field, value).moves(0))
        return approach.force, first.speed

    assert stroke("force", 0.5) == pytest.approx((1.0, 0.1))
    assert stroke("slip_speed", 0.5) == pytest.approx((2.0, 0.05))


def test_without_stick_slip_a_moving_surface_holds_as_well_as_one_at_rest() -> None:
    p, half = (stressed(PLAIN, "stick_slip", value).parameters for value in (0.0, 0.5))
    assert p.static_friction == p.kinetic_friction == Parameters().kinetic_friction
    assert half.static_friction == pytest.approx(
        (Parameters().static_friction + Parameters().kinetic_friction) / 2
    )


def test_slip_speed_is_one_speed_and_no_rotation() -> None:
    plan = plan_of("slip_speed", PaperPlan(repeats=1))
    strokes = [
        move
        for scene in plan.scenes(0)
        for _, move in stressed(scene, "slip_speed", 0.2).moves(0)
        if move.speed
    ]
    assert {move.motion for move in strokes} == {"translation"}
    assert {round(move.speed, 6) for move in strokes} == {0.01}
    assert FIELDS["slip_speed"].show(0.2) == "10 mm/s"
    assert plan_of("noise", PaperPlan(repeats=1)) == PaperPlan(repeats=1)
