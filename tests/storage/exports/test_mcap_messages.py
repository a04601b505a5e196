"""Rows of a session as MCAP messages."""

import json
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from operators.batch import EVERY, Clocks, Episodes, Motion, Slips, Zeroed, s
from operators.errors import InputError
from storage.exports.mcap_messages import messages, schema, topic
from storage.layout import CLOCKS, EPISODES, MOTION, SLIPS, TABLES, TOUCH, Table
from tests.storage.made import new_batch, new_episodes

SIMPLE = {"object", "array", "number", "integer", "boolean", "string"}


def types(found: Any) -> list[Any]:  # noqa: ANN401 - any part of a schema
    """Every type that a schema names, and none where one is missing."""
    nested = [*found.get("properties", {}).values(), *([found["items"]] if "items" in found else [])]
    return [found.get("type"), *(each for value in nested for each in types(value))]


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.name)
def test_foxglove_can_read_a_schema(table: Table) -> None:
    found = schema(table, table.kind)
    Draft202012Validator.check_schema(found)
    assert set(types(found)) <= SIMPLE  # it knows no list of types, and no null
    assert found["title"] == f"slipflow.{table.kind.__name__}"
    for name, column in table.columns.items():
        if name != "time" and column.unit:
            assert column.unit in found["properties"][name]["description"]


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.name)
def test_a_message_matches_its_schema(table: Table) -> None:
    validator: Any = Draft202012Validator(schema(table, table.kind))
    batch = new_batch(table.kind, 20, start=s)
    for name, column in table.columns.items():
        if column.dtype.kind == "f":
            getattr(batch, name)[:] = np.arange(20).reshape(-1, *([1] * len(column.shape))) / 3
    for _, message in messages(table, batch):
        validator.validate(json.loads(message))


def test_a_message_has_the_columns_of_the_row() -> None:
    velocity, pose = np.array([[0.1, 0, -0.2, 0, 0, 1e-9]]), np.full((1, 6), np.nan)
    pose[0, 2] = 0.5
    times = np.array([1_700_000_000_123_456_789])
    batch = Motion(times, np.array([-1]), velocity, pose, finger=EVERY)
    ((time, data),) = messages(MOTION, batch)
    assert time == times[0]
    assert json.loads(data) == {
        "timestamp": {"sec": 1_700_000_000, "nsec": 123_456_789},
        "device_time": {"sec": -1, "nsec": 999_999_999},
        "velocity": [0.1, 0, -0.2, 0, 0, 1e-9],
        "pose": [None, None, 0.5, None, None, None],
    }


def test_unknown_values_are_omitted() -> None:
    slips = Slips(np.array([5]), np.array([1], np.int8), np.array([4]), np.array([np.nan]), finger=2)
    ((_, data),) = messages(SLIPS, slips)
    assert json.loads(data) == {
        "timestamp": {"sec": 0, "nsec": 5},
        "finger": 2,
        "state": 1,
        "start": {"sec": 0, "nsec": 4},
    }
    clocks = Clocks(np.array([5]), np.array([4]), np.array([np.inf]), np.array([0.5]))
    ((_, data),) = messages(CLOCKS, clocks)
    assert "drift" not in json.loads(data)


def test_topics_of_fingertip_tables_have_the_number() -> None:
    found = [topic(table, 3 if table.finger else EVERY) for table in TABLES]
    assert found == [
        *("/touch/3", "/motion", "/samples/3", "/slip/3", "/faults", "/clocks", "/episodes", "/truth/3")
    ]


def test_zeroed_counts_have_a_separate_schema() -> None:
    assert schema(TOUCH, Zeroed)["title"] == "slipflow.Zeroed"


def test_a_row_from_before_1970_is_an_error() -> None:
    with pytest.raises(InputError, match="motion, a row at -1 ns: is from before 1970"):
        list(messages(MOTION, new_batch(Motion, 1, start=-1)))


def test_codes_are_written_as_their_names() -> None:
    [(time, data)] = messages(EPISODES, new_episodes((s, 2 * s + 1, "tap")))
    assert time == s
    message = json.loads(data)
    assert message == {
        "timestamp": {"sec": 1, "nsec": 0},
        "end": {"sec": 2, "nsec": 1},
        "motion": "tap",
        "surface": "plane",
        "direction": 0.0,
        "speed": 0.0,
        "angular_speed": 0.0,
    }
    validator: Any = Draft202012Validator(schema(EPISODES, Episodes))
    validator.validate(message)
