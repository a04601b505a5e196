import logging
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.ur.rtde import Kind, Recipe, RtdeError, Version, ask_outputs, pack
from connectors.ur.rtde_subscription import Subscription

NAMES = ("timestamp", "actual_q")
RECIPE = Recipe(7, NAMES, ("DOUBLE", "VECTOR6D"))
VERSION = Version(3, 15, 8, 1)
ANSWERS = [
    pack(Kind.PROTOCOL, b"\1"),
    pack(Kind.CONTROLLER, VERSION.payload),
    pack(Kind.OUTPUTS, RECIPE.answer),
    pack(Kind.START, b"\1"),
]
DATA = [RECIPE.pack((k / 125, (k, 0, 0, 0, 0, 0))) for k in range(3)]


def taken(subscription: Subscription) -> bytes:
    """What it wants to send."""
    outgoing = bytes(subscription.outgoing)
    subscription.outgoing.clear()
    return outgoing


def read(subscription: Subscription, data: bytes) -> tuple[list[bytes], str]:
    """The data packages that come out, and why no more do."""
    found = list[bytes]()
    try:
        for payload in subscription.feed(data):
            found.append(payload)
    except RtdeError as error:
        return found, str(error)
    return found, ""


def test_each_answer_is_followed_by_the_next_request() -> None:
    subscription = Subscription(NAMES, 125.0)
    requests = [taken(subscription)]
    for answer in ANSWERS:
        assert not subscription.started
        assert not list(subscription.feed(answer))
        requests.append(taken(subscription))
    assert requests == [
        pack(Kind.PROTOCOL, b"\0\2"),
        pack(Kind.CONTROLLER),
        pack(Kind.OUTPUTS, ask_outputs(125.0, NAMES)),
        pack(Kind.START),
        b"",
    ]
    assert subscription.started
    assert subscription.controller == VERSION
    assert subscription.recipe == RECIPE


@given(st.lists(st.integers(0, 400), max_size=20))
def test_any_cut_of_a_connection_gives_the_same_data(cuts: list[int]) -> None:
    stream = b"".join([*ANSWERS, *(pack(Kind.DATA, payload) for payload in DATA)])
    places = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    subscription = Subscription(NAMES, 125.0)
    found = [each for start, stop in pairwise(places) for each in subscription.feed(stream[start:stop])]
    assert found == DATA


@pytest.mark.parametrize(
    ("answers", "wrong", "reason"),
    [
        (0, pack(Kind.PROTOCOL, b"\0"), "does not speak version 2"),
        (0, pack(Kind.CONTROLLER, VERSION.payload), "'v' where 'V'"),
        (0, pack(Kind.DATA, DATA[0]), "'U' where 'V'"),
        (1, pack(Kind.CONTROLLER, b"\1"), "version in 1 bytes"),
        (2, pack(Kind.OUTPUTS, b"\0DOUBLE,NOT_FOUND"), "actual_q NOT_FOUND"),
        (3, pack(Kind.START, b"\0"), "refused to start"),
        (3, pack(Kind.DATA, DATA[0]), "'U' where 'S'"),
        (4, pack(Kind.DATA, DATA[0][:-1]), "data of 56 bytes"),
        (4, pack(Kind.DATA, b"\1" + DATA[0][1:]), "recipe 01, not 57 for 07"),
        (4, pack(Kind.PAUSE, b"\1"), "'P' where 'U'"),
        (4, b"HTTP/1.1 400 Bad Request", "package of 18516 bytes"),
    ],
)
def test_what_is_not_due_is_an_error_and_what_came_before_counts(
    answers: int, wrong: bytes, reason: str
) -> None:
    before = [*ANSWERS[:answers], *([pack(Kind.DATA, DATA[0])] if answers == 4 else [])]
    found, error = read(Subscription(NAMES, 125.0), b"".join([*before, wrong]))
    assert reason in error
    assert found == (DATA[:1] if answers == 4 else [])


def test_what_the_controller_says_goes_to_the_log(caplog: pytest.LogCaptureFixture) -> None:
    subscription = Subscription(NAMES, 125.0)
    said = pack(Kind.TEXT, b"\x05hel\nx\x04RTDE\1")
    with caplog.at_level(logging.WARNING):
        assert list(subscription.feed(b"".join([*ANSWERS, said, pack(Kind.DATA, DATA[0])]))) == DATA[:1]
    assert [record.message for record in caplog.records] == ["controller: hel x (RTDE)"]
