from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.batch import s
from operators.errors import InputError
from operators.ports import Json
from storage.episodes import NONE, Episodes, listings


def test_episodes_are_numbered_in_the_order_of_time_whatever_the_sources() -> None:
    episodes = Episodes.described(
        {
            "arm": {"episodes": [{"start": 20, "end": 30, "motion": "hold"}]},
            "rig": {"seed": 0, "episodes": [{"start": 0, "end": 20, "speed": 0.05, "direction_deg": 45}]},
        }
    )
    rows = episodes.table.to_pylist()
    assert [(row["episode"], row["start"], row["motion"]) for row in rows] == [(0, 0, None), (1, 20, "hold")]
    assert (rows[0]["speed"], rows[0]["direction_deg"], rows[0]["split"]) == (0.05, 45.0, None)


def test_what_two_sources_both_list_counts_once() -> None:
    listed: Any = {"episodes": [{"start": 0, "end": 5, "motion": "tap"}]}
    assert len(Episodes.described({"touch": listed, "motion": listed}).table) == 1


@given(edges=st.lists(st.integers(-50, 50), unique=True), times=st.lists(st.integers(-60, 60)))
def test_every_instant_belongs_to_the_episode_that_it_lies_in(edges: list[int], times: list[int]) -> None:
    edges.sort()
    spans = list(zip(edges[::2], edges[1::2], strict=False))
    listed: Any = [{"start": start, "end": end} for start, end in spans]
    found = Episodes.described({"rig": {"episodes": listed}}).at(np.array(times, np.int64))
    expected = [
        next((n for n, (start, end) in enumerate(spans) if start <= time < end), NONE) for time in times
    ]
    assert found.dtype == np.int32
    assert found.tolist() == expected


def test_without_episodes_there_is_no_row_and_no_number() -> None:
    episodes = Episodes.described({"rig": {}})
    assert len(episodes.table) == 0
    assert episodes.at(np.array([-s, 0, s])).tolist() == [NONE] * 3


@pytest.mark.parametrize(
    ("listed", "complaint"),
    [
        ({}, '"episodes" is not a list'),
        ([3], "episode 0: needs a start and a later end"),
        ([{"start": 0}], "needs a start"),
        ([{"start": 0.0, "end": 1.0}], "needs a start"),
        ([{"start": 5, "end": 5}], "needs a start"),
        ([{"start": 0, "end": 2}, {"start": 1, "end": 3}], "0 and 1 in the order of time overlap"),
        ([{"start": 0, "end": 2, "speed": "fast"}], "a value has the wrong type"),
        ([{"start": 0, "end": 2, "motion": 1}], "a value has the wrong type"),
        ([{"start": 0, "end": 2**70}], "a value has the wrong type"),
    ],
)
def test_episodes_that_cannot_be_are_refused(listed: Json, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        Episodes.described({"rig": {"episodes": listed}})


def test_a_list_that_sources_share_is_given_once_and_equal_ones_are_told_apart() -> None:
    shared: list[Json] = [{"start": 1, "end": 2}]
    found = listings({"touch": {"episodes": shared}, "motion": {"episodes": shared}, "other": {}})
    assert found == {"touch": shared, "other": []}
    assert list(listings({"touch": {"episodes": shared}, "motion": {"episodes": [*shared]}})) == [
        "touch",
        "motion",
    ]
