import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from operators import SLIP, STATIC, Debounce, Scores, ms

HIGH, LOW, NONE = 0.9, 0.1, float("nan")
Event = tuple[int, int, int]  # state, row, row of the start


def _events(debounce: Debounce, *probability: float) -> list[Event]:
    """What comes of scores 10 ms apart."""
    time = np.arange(len(probability)) * 10 * ms
    slips = debounce.push(Scores(time, np.array(probability), finger=7))
    assert slips.finger == 7 or not len(slips)
    rows, starts = (slips.time // (10 * ms)).tolist(), (slips.start // (10 * ms)).tolist()
    np.testing.assert_array_equal(slips.probability, np.array(probability)[rows])
    return list(zip(slips.state.tolist(), rows, starts, strict=True))


def _reference(probability: list[float], consecutive: int, release: int) -> list[Event]:
    """Reference implementation, row by row."""
    events: list[Event] = []
    for row, value in enumerate(probability):
        slipping = bool(events) and events[-1][0] == SLIP
        run = row  # of decisions equal to this one
        while run and (probability[run - 1] >= 0.5) == (value >= 0.5) and not np.isnan(probability[run - 1]):
            run -= 1
        length = row - run + 1
        if np.isnan(value):
            continue
        if not slipping and value >= 0.5 and length >= consecutive:
            events.append((SLIP, row, run))
        if slipping and value < 0.5 and length >= release:
            events.append((STATIC, row, run))
    return events


@given(
    probability=st.lists(st.sampled_from([HIGH, LOW, 0.5, NONE]), max_size=80),
    consecutive=st.integers(1, 4),
    release=st.integers(1, 4),
)
def test_events_are_those_of_the_rule(probability: list[float], consecutive: int, release: int) -> None:
    debounce = Debounce(consecutive=consecutive, release=release)
    assert _events(debounce, *probability) == _reference(probability, consecutive, release)
    assert len(debounce.flush()) == 0  # a slip that is open has no end


def test_events_do_not_keep_the_memory_of_their_batch() -> None:
    probability = np.full(10_000, HIGH)
    slips = Debounce().push(Scores(np.arange(10_000), probability))
    assert slips.packed.nbytes < 100
