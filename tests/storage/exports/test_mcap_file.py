"""A session as an MCAP file, read back by the library's reader."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from operators.batch import Batch, Episodes, Faults, Labelled, Motion, Slips, Touch, Truth, ms, s
from operators.errors import InputError
from storage.exports.mcap_file import export, messages, topic
from storage.hand_labels import LabelSpan
from storage.layout import MOTION, TABLE_OF
from tests.storage.made import new_batch, record

pytest.importorskip("mcap", reason="needs the extra `mcap`")

Message = tuple[str, int, dict[str, Any]]


def read(path: Path) -> list[Message]:
    """Topic, log time and content of each message, as a viewer gets them; all match their schemas."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        found: list[Message] = []
        for stored, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert stored is not None
            assert (stored.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert message.publish_time == message.log_time
            schema, content = json.loads(stored.data), json.loads(message.data)
            # as in Foxglove's own JSON schemas: what marks a stamp there is its title
            stamp_of = schema["properties"]["timestamp"]
            assert (stamp_of["type"], stamp_of["title"]) == ("object", "time")
            assert stamp_of["properties"] == {key: {"type": "integer"} for key in ("sec", "nsec")}
            assert set(content) <= set(schema["properties"])
            validator: Any = Draft202012Validator(lenient(schema))
            validator.validate(content)
            found.append((channel.topic, message.log_time, content))
        return found


def summary(path: Path) -> tuple[Any, list[Any], list[Any]]:
    """Its statistics, its metadata, its chunks."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        reader = make_reader(file)
        found = reader.get_summary()
        assert found is not None
        return found.statistics, list(reader.iter_metadata()), found.chunk_indexes


def rows(batch: Batch) -> list[Message]:
    """The messages that a batch must have become, made here by a rule of one's own."""
    table = TABLE_OF[type(batch)]
    found: list[Message] = []
    for row, time in enumerate(batch.time.tolist()):
        message: dict[str, Any] = {"timestamp": stamp(time)}
        if table.finger:
            message["finger"] = batch.finger
        for name, column in table.columns.items():
            value = getattr(batch, name)[row].tolist()
            if name == "time":
                continue
            if column.names:
                message[name] = column.names[value]
            elif column.unit == "ns":
                message[name] = stamp(value)
            elif column.shape:
                listed = [known(each) for each in value]
                if any(each is not None for each in listed):
                    message[name] = listed
            elif known(value) is not None:
                message[name] = value
        found.append((topic(table, batch.finger), time, message))
    return found


def stamp(time: int) -> dict[str, int]:
    return {"sec": time // s, "nsec": time % s}


def known(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def alike(messages: list[Message]) -> list[str]:
    """Messages so that they can be sorted and compared, bit for bit."""
    return sorted(json.dumps(each, sort_keys=True) for each in messages)


def test_every_row_of_every_table_is_a_message_of_its_schema_in_time_order(tmp_path: Path) -> None:
    batches = [
        *(new_batch(Touch, 50, start=s + 3 * finger, finger=finger, seed=finger) for finger in (0, 2)),
        new_batch(Motion, 70, start=s + 5 * ms, seed=3),
        new_batch(Labelled, 45, start=s, finger=2, seed=4),
        new_batch(Slips, 4, start=s, finger=2, seed=5),
        new_batch(Faults, 3, start=s, finger=0, seed=6),
        new_batch(Faults, 3, start=s + 1, finger=2, seed=7),
        new_batch(Episodes, 9, start=s, seed=9),
        new_batch(Truth, 9, start=s, seed=10),
    ]
    path = tmp_path / "one.mcap"
    counted = export(record(tmp_path, batches), path)
    found = read(path)
    assert [time for _, time, _ in found] == sorted(time for _, time, _ in found)
    expected = [message for batch in batches for message in rows(batch)]
    assert alike(found) == alike(expected)
    assert dict(counted) == {name: sum(each[0] == name for each in expected) for name in counted}
    assert len(expected) == sum(counted.values())


def lenient(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema with null among the numbers, which Foxglove takes and its schemas cannot say."""
    found = dict(schema)
    if found.get("type") == "number":
        found["type"] = ["number", "null"]
    if "items" in found:
        found["items"] = lenient(found["items"])
    if "properties" in found:
        found["properties"] = {name: lenient(each) for name, each in found["properties"].items()}
    return found


def test_the_file_has_the_session_description_and_message_counts(tmp_path: Path) -> None:
    session = record(tmp_path, [new_batch(Touch, 30, start=s), new_batch(Motion, 20, start=2 * s)])
    session.write_hand_labels([LabelSpan(s, 2 * s, 0, "slip")], based_on=0)
    path = tmp_path / "one.mcap"
    session = replace(session, about={**session.about, "host": "caf\udce9", "large": 2**70})
    export(session, path)
    statistics, (metadata, labels), chunks = summary(path)
    assert (statistics.message_count, statistics.channel_count, statistics.schema_count) == (50, 2, 2)
    assert (statistics.message_start_time, statistics.message_end_time) == (s, 2 * s + 190 * ms)
    assert metadata.name == "session"
    assert set(metadata.metadata) == set(session.about)
    assert (metadata.metadata["session"], metadata.metadata["host"]) == ("one", "caf?")
    assert json.loads(metadata.metadata["sinks"]) == session.about["sinks"]
    assert (labels.name, labels.metadata["version"]) == ("hand_labels", "1")
    [span] = json.loads(labels.metadata["spans"])
    assert (span["begin"], span["end"], span["value"]) == (s, 2 * s, "slip")
    assert {chunk.compression for chunk in chunks} == {"zstd"}


def test_a_failed_export_leaves_no_file(tmp_path: Path) -> None:
    session = record(tmp_path / "data", [new_batch(Touch, 50, start=s), new_batch(Motion, 50, start=s)])
    last = max(session.folder.glob("touch/*.parquet"))
    last.write_bytes(last.read_bytes()[:-1])
    with pytest.raises(InputError, match="is damaged"):
        export(session, tmp_path / "one.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def test_a_row_from_before_1970_is_an_error() -> None:
    with pytest.raises(InputError, match="motion, a row at -1 ns: is from before 1970"):
        list(messages(MOTION, new_batch(Motion, 1, start=-1)))
