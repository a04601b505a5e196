from hypothesis import given, settings
from hypothesis import strategies as st

from connectors.sim.finger import Finger
from connectors.sim.scene import Faults, Move, Scene, Timing, Vibration
from operators.batch import Touch, Truth, concat
from tests.storage.made import same

STROKE = (
    Move("hold", 0.3, force=0.0),
    Move("hold", 0.5, force=2.0),
    Move("translation", 0.6, 0.1, 30.0, 0.1),
    Move("rotation", 0.5, 0.1, speed=1.0),
)


def take(finger: Finger, samples: int) -> tuple[Touch, Truth]:
    taken = finger.take(samples)
    assert taken is not None
    return taken


SCENE = Scene(
    STROKE,
    vibration=Vibration(),
    touch=Timing(100.0, wander=0.004, dropped=0.2),
    faults=Faults(dead=1, gain=1.1, drift=5.0),
)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 60), min_size=1, max_size=8))
def test_cutting_the_simulation_changes_nothing(cuts: list[int]) -> None:
    whole, happened = take(Finger(SCENE, 5), sum(cuts))
    finger = Finger(SCENE, 5)
    parts = [taken for samples in cuts if (taken := finger.take(samples)) is not None]
    same(concat(Touch, [part for part, _ in parts]), whole)
    same(concat(Truth, [part for _, part in parts]), happened)
