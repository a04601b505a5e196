from tests.chaos import bit_flips
from tests.chaos.scale import Scale


def test_a_flipped_bit_never_gives_a_wrong_value_in_silence() -> None:
    promise = bit_flips.flips(Scale(short=True))
    assert promise.passed, promise.result
