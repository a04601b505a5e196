import pytest

from flows.run.cluster.work_units import LIMIT, Claim, Done, End, Rows, Slice, deal_of
from operators import InputError

ROWS = Rows("touch", 3, "touch/part-000001.parquet", "0" * 64, 10, 1010)
FOLDER, SOURCES = "/data/sessions/one", {"touch": (0, 3), "motion": (-1,)}
CLAIM = Claim("one", FOLDER, 1, 2, (3,), 12, 7, SOURCES, (Slice(56, (ROWS,)),))
LAST = Claim("one", FOLDER, 1, 2, (3, 5), 12, 8, SOURCES, (), End(57, 9, ((0,), (1,), (3, 5))))


@pytest.mark.parametrize("claim", [CLAIM, LAST])
def test_a_claim_comes_back_from_its_line(claim: Claim) -> None:
    assert "\n" not in claim.line()
    assert Claim.read(claim.line()) == claim


@pytest.mark.parametrize(
    "done", [Done("one", "/one", 0, 3, 10, End(57, 9, ((0, 3),))), Done("one", "/one", 0, 3, 10, None, "why")]
)
def test_what_is_done_comes_back_from_its_line(done: Done) -> None:
    assert Done.read(done.line()) == done


def test_shares_sessions_and_turns_have_keys_of_their_own() -> None:
    assert CLAIM.key == "one/1/2"
    assert Done("one", "/one", 1, 3, 10, None).key == "one/1"


def test_a_line_tells_whose_turn_it_is_before_all_else() -> None:
    assert deal_of(CLAIM.line()) == 12
    assert deal_of(Done("one", "/one", 1, 3, 10, None).line()) == 10


@pytest.mark.parametrize(
    "line", ["", "[]", "null", "{}", CLAIM.line()[:-9], CLAIM.line().replace("slices", "x")]
)
def test_a_line_that_is_no_claim_is_an_error(line: str) -> None:
    with pytest.raises(InputError, match="claim: cannot be read"):
        Claim.read(line)


@pytest.mark.parametrize("line", ["", "[]", "{}", CLAIM.line()])
def test_a_line_that_tells_of_nothing_done_is_an_error(line: str) -> None:
    with pytest.raises(InputError, match="done: cannot be read"):
        Done.read(line)


@pytest.mark.parametrize("kind", [Claim, Done])
def test_a_line_that_is_too_long_is_an_error(kind: type[Claim | Done]) -> None:
    with pytest.raises(InputError, match="is longer than"):
        kind.read(" " * (LIMIT + 1))
