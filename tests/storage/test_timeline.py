from collections.abc import Callable, Mapping
from typing import Any, Self

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.errors import InputError
from operators.ports import Description, Json
from storage import timeline
from storage.episodes import NONE, Episodes
from storage.timeline import Timeline


def spans(*edges: int) -> list[Json]:
    return [{"start": edges[n], "end": edges[n + 1]} for n in range(0, len(edges), 2)]


TIMES = np.arange(-5, 60)


def alike(found: Timeline, describe: dict[str, Description]) -> bool:
    whole, all_at_once = Episodes.described(describe), found.at(TIMES)
    later = [found.at(TIMES[first:]).tolist() for first in range(len(TIMES) + 1)]
    return (
        all_at_once.dtype == np.int32
        and all_at_once.tolist() == whole.at(TIMES).tolist()
        and all(each == all_at_once[first:].tolist() for first, each in enumerate(later))
    )


@given(
    edges=st.lists(st.integers(-4, 50), unique=True, max_size=16),
    sources=st.lists(st.sampled_from(["touch", "motion", "both"]), min_size=8, max_size=8),
    looks=st.sets(st.integers(0, 8)),
)
def test_it_numbers_instants_as_all_episodes_put_together_do(
    edges: list[int], sources: list[str], looks: set[int]
) -> None:
    touch, motion = list[Json](), list[Json]()
    describe: dict[str, Description] = {"touch": {"episodes": touch}, "motion": {"episodes": motion}}
    found = Timeline(describe)
    listed = spans(*sorted(edges)[: len(edges) // 2 * 2])
    for number, (each, source) in enumerate(zip(listed, sources, strict=False)):
        touch += [each] if source != "motion" else []
        motion += [each] if source != "touch" else []
        if number in looks:
            assert found.look()
            assert alike(found, describe)
    found.look()
    assert alike(found, describe)
    assert not found.look()


@pytest.fixture
def described(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A 1 for each time that all are put together anew."""
    calls = list[int]()

    class Counted(Episodes):
        @classmethod
        def described(cls, descriptions: Mapping[str, Description]) -> Self:
            calls.append(1)
            return super().described(descriptions)

    monkeypatch.setattr(timeline, "Episodes", Counted)
    return calls


def test_one_list_that_grows_is_never_put_together_anew(described: list[int]) -> None:
    listed = list[Json]()
    describe: dict[str, Description] = {"touch": {"episodes": listed}, "motion": {}}
    found = Timeline(describe)
    for number in range(10):
        newest: Any = listed[-1] if listed else {}
        newest["end"] = 5 * number
        listed += spans(5 * number, 1000)
        assert found.look()
        assert alike(found, describe)
    listed[:] = spans(30, 35)
    found.look()
    assert alike(found, describe)
    assert described == []


def test_a_list_out_of_order_is_put_together_anew(described: list[int]) -> None:
    listed = spans(20, 30)
    found = Timeline({"rig": {"episodes": listed}})
    found.look()
    listed += spans(0, 10)
    found.look()
    assert alike(found, {"rig": {"episodes": listed}})
    assert described == [1]


WRONG: list[Callable[[], list[Json]]] = [
    lambda: spans(5, 15),
    lambda: [3],
    lambda: [{"start": 10, "end": 20, "speed": "fast"}],
    lambda: [{"start": 10, "end": 2**70}],
]


@pytest.mark.parametrize("wrong", WRONG)
def test_what_cannot_be_is_refused_until_it_is_put_right(wrong: Callable[[], list[Json]]) -> None:
    listed = spans(0, 10)
    found = Timeline({"rig": {"episodes": listed}})
    found.look()
    listed += wrong()
    for _ in range(2):
        with pytest.raises(InputError):
            found.look()
        assert found.at(np.array([5, 12])).tolist() == [0, NONE]
    listed[1:] = spans(10, 20)
    assert found.look()
    assert found.at(np.array([5, 12, 20])).tolist() == [0, 1, NONE]


def test_without_episodes_there_is_no_number() -> None:
    found = Timeline({"rig": {}})
    assert not found.look()
    assert found.at(TIMES).tolist() == [NONE] * len(TIMES)
    assert found.at(TIMES[:0]).tolist() == []
