from tests.chaos import power_cut
from tests.chaos.scale import Scale


def test_whatever_ends_the_journal_no_row_is_made_up_and_what_was_durable_is_there() -> None:
    promise = power_cut.tails(Scale(short=True))
    assert promise.passed, promise.result


def test_a_power_cut_at_any_step_of_a_session_costs_only_what_was_not_durable() -> None:
    promise = power_cut.lives(Scale(short=True))
    assert promise.passed, promise.result
