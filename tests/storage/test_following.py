import copy
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.errors import InputError
from operators.ports import Json
from storage.following import Following, put_together
from storage.frames import Change


def episode(start: int, **more: Json) -> dict[str, Json]:
    return {"start": start, "end": start + 1, **more}


def took(following: Following) -> list[Change]:
    changes = following.look()
    following.took(changes)
    return changes


def test_an_episode_is_given_when_it_begins_and_when_it_changes_and_not_again() -> None:
    listed: list[Json] = [episode(0)]
    following = Following({"rig": {"episodes": listed}})
    assert took(following) == [Change("rig", 0, [episode(0)])]
    assert took(following) == []
    listed[0] = episode(0, motion="tap")
    listed += [episode(1), episode(2)]
    assert took(following) == [Change("rig", 0, [episode(0, motion="tap"), episode(1), episode(2)])]
    newest: Any = listed[-1]
    newest["end"] = 9
    assert took(following) == [Change("rig", 2, [{"start": 2, "end": 9}])]
    listed.append(episode(9))
    assert took(following) == [Change("rig", 2, [{"start": 2, "end": 9}, episode(9)])]
    assert took(following) == []


def test_what_is_given_costs_no_more_the_longer_the_list() -> None:
    listed: list[Json] = []
    following, most = Following({"rig": {"episodes": listed}}), 0
    for start in range(1000):
        listed.append(episode(start))
        [change] = took(following)
        most = max(most, len(change.episodes))
    assert most == 2


def test_what_was_not_taken_is_given_again() -> None:
    listed: list[Json] = [episode(0)]
    following = Following({"rig": {"episodes": listed}})
    assert following.look() == following.look() == [Change("rig", 0, [episode(0)])]


def test_a_source_that_empties_its_list_begins_anew() -> None:
    listed: list[Json] = [episode(0), episode(1)]
    following = Following({"rig": {"episodes": listed}})
    took(following)
    listed.clear()
    assert took(following) == [Change("rig", 0, [])]
    assert took(following) == []
    listed += [episode(7), episode(8), episode(9)]
    assert took(following) == [Change("rig", 0, listed)]
    listed[:] = [episode(start) for start in (20, 21, 22)]  # as long as before
    assert took(following) == [Change("rig", 0, listed)]


def test_a_source_that_describes_none_any_more_has_none() -> None:
    describe: dict[str, Any] = {"rig": {"episodes": [episode(0)]}, "arm": {}}
    following = Following(describe)
    took(following)
    describe["rig"] = {}
    assert took(following) == [Change("rig", 0, [])]


def test_what_is_no_list_is_refused() -> None:
    with pytest.raises(InputError, match='"episodes" is not a list'):
        Following({"rig": {"episodes": 3}}).look()


def test_changes_of_which_some_are_missing_are_refused() -> None:
    with pytest.raises(InputError, match=r"^log: lacks episodes of source 'rig' before number 3"):
        put_together([Change("rig", 0, [1, 2]), Change("rig", 3, [4])], "log")


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["touch", "motion"]),
            st.sampled_from(["add", "change", "drop", "clear", "look"]),
            st.integers(0, 5),
        ),
        max_size=60,
    )
)
def test_all_changes_put_together_are_what_the_sources_describe(steps: list[tuple[str, str, int]]) -> None:
    describe: dict[str, Any] = {"touch": {"episodes": []}, "motion": {"episodes": []}}
    following, changes, time = Following(describe), list[Change](), 0
    for source, action, number in steps:
        listed: list[Any] = describe[source]["episodes"]
        if action == "add":
            listed.append(episode(time := time + 1))
        elif action == "change" and listed:
            listed[-1]["end"] = time + number
        elif action == "drop":
            del listed[-1:]
        elif action == "clear":
            listed.clear()
        elif action == "look":
            changes += copy.deepcopy(took(following))
    changes += took(following)
    found = put_together(changes, "log")
    assert {source: about["episodes"] for source, about in found.items() if about["episodes"]} == {
        source: about["episodes"] for source, about in describe.items() if about["episodes"]
    }
