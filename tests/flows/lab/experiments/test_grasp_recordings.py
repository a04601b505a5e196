import numpy as np

from connectors.sim.objects import OBJECTS
from flows.lab.experiments.grasp_recordings import CREEPS, by_sliding, handled, things
from flows.learn.labelled_recordings import WARM_UP
from operators.batch import SLIP, STATIC, UNKNOWN, ms

COUNT = 20


def test_a_recording_is_the_same_for_its_seed_and_like_no_other() -> None:
    first, again, other = (list(handled(2, seed)) for seed in (1, 1, 2))
    assert all((a.counts == b.counts).all() for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0].counts[:100], other[0].counts[:100])


def test_eight_of_ten_train_one_validates_and_one_tests() -> None:
    splits = [trial.split for trial in handled(COUNT, 3)]
    assert {split: splits.count(split) for split in splits} == {"train": 16, "validation": 2, "test": 2}


def test_labels_are_what_truly_slides_and_both_occur() -> None:
    trials = list(handled(COUNT, 4))
    for trial in trials:
        assert trial.sliding is not None
        assert (trial.label[trial.sliding] == SLIP).all()
        assert (trial.label[:WARM_UP] != SLIP).all()  # the hand is open
    label = np.concatenate([trial.label for trial in trials])
    assert 0.02 < (label == SLIP).mean() < 0.3
    assert (label == UNKNOWN).mean() < 0.05
    assert 0 < CREEPS < 1


def test_short_sticks_belong_to_a_slip_and_long_ones_do_not() -> None:
    sliding = np.zeros(40, np.bool_)
    sliding[[10, 13, 14, 25]] = True
    assert np.flatnonzero(by_sliding(sliding, 50 * ms) == SLIP).tolist() == [10, 11, 12, 13, 14, 25]
    assert (by_sliding(np.zeros(9, np.bool_)) == STATIC).all()


def test_objects_span_more_than_the_six_that_are_judged() -> None:
    drawn = list(things(300, 5))
    assert {each.curvature for each in drawn} >= {each.curvature for each in OBJECTS.values()}
    for name in ("mass", "friction", "texture", "stiffness"):
        values = [getattr(each, name) for each in drawn]
        known = [getattr(each, name) for each in OBJECTS.values()]
        assert min(values) < min(known)
        assert max(values) > max(known)
    assert not {(each.mass, each.radius) for each in drawn} & {
        (each.mass, each.radius) for each in OBJECTS.values()
    }
