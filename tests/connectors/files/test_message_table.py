"""Traces in MCAP files and ROS 2 bags."""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.files.formats import read_table
from connectors.files.trace_table import TraceTable
from flows.lab.importing import TraceImport
from operators.batch import EVERY, Motion, Touch, s
from operators.errors import InputError, ParameterError
from storage.exports.mcap_file import export
from storage.session import Session

START = 1_700_000_000 * s  # ns
ROWS = 50
TAXELS = "std_msgs/Header header\nuint16[6] counts\nfloat32 pressure\nstring state\n"


def write_json(path: Path, messages: list[tuple[str, Any]], **settings: Any) -> Path:  # noqa: ANN401
    """Write messages of (topic, content), 10 ms apart."""
    with path.open("wb") as file:
        writer: Any = Writer(file, **settings)
        writer.start()
        schema, channels = writer.register_schema("pad", "jsonschema", b"{}"), dict[str, int]()
        for number, (topic, content) in enumerate(messages):
            channel = channels.get(topic) or writer.register_channel(topic, "json", schema)
            channels[topic] = channel
            time = START + number * 10_000_000
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            writer.add_message(channel, time, data, time)
        writer.finish()
    return path


def write_bag(folder: Path, plugin: StoragePlugin) -> Path:
    """Write a bag with a fingertip at 100 Hz and joint states and twists at 50 Hz."""
    store = get_typestore(Stores.LATEST)
    store.register(get_types_from_msg(TAXELS, "pad_msgs/msg/Taxels"))
    kinds: Any = store.types
    header, stamp = kinds["std_msgs/msg/Header"], kinds["builtin_interfaces/msg/Time"]
    with BagWriter(folder, version=9, storage_plugin=plugin) as bag:
        names = {
            "/pad": "pad_msgs/msg/Taxels",
            "/joint_states": "sensor_msgs/msg/JointState",
            "/tcp": "geometry_msgs/msg/TwistStamped",
        }
        topics = {topic: bag.add_connection(topic, name, typestore=store) for topic, name in names.items()}
        for row in range(ROWS):
            time = START + row * 10_000_000
            head = header(stamp(sec=time // s, nanosec=time % s), "pad")
            counts = np.arange(6, dtype=np.uint16) + row
            pad = kinds["pad_msgs/msg/Taxels"](head, counts, 1.5 * row, "slip" if row > 20 else "static")
            bag.write(topics["/pad"], time + 3_000_000, store.serialize_cdr(pad, pad.__msgtype__))
            if row % 2:
                continue
            moving = np.array([0.0, -0.5 * (row > 20)])
            joints = kinds["sensor_msgs/msg/JointState"](head, ["j0", "j1"], moving, moving, np.array([]))
            bag.write(topics["/joint_states"], time, store.serialize_cdr(joints, joints.__msgtype__))
            vector = kinds["geometry_msgs/msg/Vector3"]
            twist = kinds["geometry_msgs/msg/Twist"](vector(0.02, 0.0, 0.0), vector(0.0, 0.0, 0.1))
            tcp = kinds["geometry_msgs/msg/TwistStamped"](head, twist)
            bag.write(topics["/tcp"], time, store.serialize_cdr(tcp, tcp.__msgtype__))
    return folder


BAGS: dict[str, Callable[[Path], Path]] = {
    "folder of .mcap": lambda path: write_bag(path / "bag", StoragePlugin.MCAP),
    "folder of .db3": lambda path: write_bag(path / "bag", StoragePlugin.SQLITE3),
    ".mcap": lambda path: write_bag(path / "bag", StoragePlugin.MCAP) / "bag.mcap",
    ".db3": lambda path: write_bag(path / "bag", StoragePlugin.SQLITE3) / "bag.db3",
}


@pytest.mark.parametrize("make", BAGS.values(), ids=BAGS)
def test_a_topic_of_a_ros_2_bag_is_a_trace(make: Callable[[Path], Path], tmp_path: Path) -> None:
    path = make(tmp_path)
    trace = Trace(read_table(path, topic="/pad"), ColumnMap.parse("label=state"))
    assert trace.columns.columns["counts"] == tuple(f"counts{cell}" for cell in range(6))
    assert trace.touch.time.tolist() == [START + row * 10_000_000 for row in range(ROWS)]  # header stamps
    assert trace.touch.counts.tolist() == (np.arange(6) + np.arange(ROWS)[:, None]).tolist()
    assert trace.labels.tolist() == [int(row > 20) for row in range(ROWS)]
    assert trace.describe()["topic"] == "/pad"
    assert len(str(trace.describe()["sha256"])) == 64


@pytest.mark.parametrize("make", [BAGS[".mcap"], BAGS["folder of .db3"]], ids=["mcap", "db3"])
def test_the_motion_may_be_in_another_topic_at_other_times(
    make: Callable[[Path], Path], tmp_path: Path
) -> None:
    path = make(tmp_path)
    table = read_table(path, topic="/pad", motion_topic="/joint_states")
    trace = Trace(table, ColumnMap.parse("joint=velocity1", lever=0.1))
    assert trace.fingers(Motion) == (EVERY,)
    assert len(trace.touch) == ROWS
    assert trace.motion.time.tolist() == [START + row * 10_000_000 for row in range(0, ROWS, 2)]
    assert trace.speeds.tolist() == pytest.approx([0.05 * (row > 20) for row in range(0, ROWS, 2)])
    assert trace.columns.columns["joint"] == ("velocity1",)
    twist = Trace(read_table(path, topic="/pad", motion_topic="/tcp"))
    assert twist.motion.velocity[0].tolist() == [0.02, 0, 0, 0, 0, 0.1]


@pytest.mark.parametrize("compression", CompressionType)
def test_json_messages_are_flattened(compression: CompressionType, tmp_path: Path) -> None:
    messages = [
        ("/pad", {"taxels": [[row, row + 1], [row + 2, row + 3]], "tcp": {"v": 0.1}, "note": None})
        for row in range(ROWS)
    ]
    path = write_json(tmp_path / "a.mcap", [*messages, ("/other", {"x": 1})], compression=compression)
    table = read_table(path, topic="/pad")
    assert {"log_time_ns", "taxels00", "taxels01", "taxels10", "taxels11", "tcp.v"} <= set(table.header.names)
    trace = Trace(table, ColumnMap.parse("counts=taxels*,speed=tcp.v"))
    assert trace.touch.counts[3].tolist() == [3, 4, 5, 6]
    assert trace.touch.time[3] == START + 30_000_000


def test_fields_may_be_missing_and_of_any_length(tmp_path: Path) -> None:
    messages = [("/pad", {"p": [1, 2]}), ("/pad", {"p": [3]}), ("/pad", {"p": [4, 5], "v": 0.5})]
    trace = Trace(read_table(write_json(tmp_path / "a.mcap", messages)))
    assert trace.touch.valid.tolist() == [[True, True], [True, False], [True, True]]
    assert trace.speeds.tolist() == [0.5]


def test_an_export_can_be_imported_again(tmp_path: Path) -> None:
    time = START + np.arange(300) * 10_000_000
    cells = {f"p{cell}": np.arange(300) % (cell + 7) for cell in range(6)}
    given = TraceImport(
        TraceTable({"time_ns": time, **cells, "speed": np.full(300, 0.02)}), tmp_path / "first"
    )
    asyncio.run(given.write())
    export(Session.open(tmp_path / "first"), tmp_path / "a.mcap")
    table = read_table(tmp_path / "a.mcap", topic="/touch/0", motion_topic="/motion")
    again = Trace(table, ColumnMap.parse("velocity=velocity0..velocity5"))
    assert again.touch.time.tolist() == time.tolist()
    assert again.touch.counts.tolist() == given.trace.touch.counts.tolist()
    assert again.motion.velocity.tolist() == given.trace.motion.velocity.tolist()


def test_the_topics_are_listed_if_the_choice_is_open_or_wrong(tmp_path: Path) -> None:
    path = write_json(tmp_path / "a.mcap", [("/a", {"x": 1}), ("/b", {"x": 1}), ("/b", {"x": 1})])
    with pytest.raises(
        InputError, match=r"has the topics /a \(pad, 1\), /b \(pad, 2\): choose one with --topic"
    ):
        read_table(path)
    with pytest.raises(InputError, match=r"has the topics .*: there is no /c"):
        read_table(path, topic="/c")
    with pytest.raises(InputError, match="has no messages"):
        read_table(write_json(tmp_path / "b.mcap", []))
    with pytest.raises(ParameterError, match=r"a.csv is neither an MCAP file nor a ROS 2 bag"):
        read_table(tmp_path / "a.csv", topic="/a")


@pytest.mark.parametrize(
    "content", [b"{", b"[" * 100_000, b"\xff", json.dumps({"a": {"b": 1}}).encode()[:-1]]
)
def test_a_message_that_cannot_be_decoded_is_named(content: bytes, tmp_path: Path) -> None:
    path = write_json(tmp_path / "a.mcap", [("/a", {"x": 1}), ("/a", content)])
    with pytest.raises(InputError, match=r"a.mcap, topic /a, message 1: cannot be decoded: [^\n]+$"):
        read_table(path)


def test_a_chunk_that_unpacks_to_more_than_it_declares_is_refused(tmp_path: Path) -> None:
    path = write_json(tmp_path / "a.mcap", [("/a", {"x": "0" * 100_000})], compression=CompressionType.LZ4)
    content = path.read_bytes()
    where = content.index(b"\x04\x22\x4d\x18") - 27  # uncompressed size, CRC, "lz4", size of the data
    assert len(content) < 3000
    assert int.from_bytes(content[where : where + 8], "little") > 100_000
    path.write_bytes(content[:where] + (1000).to_bytes(8, "little") + content[where + 8 :])
    with pytest.raises(InputError, match="does not unpack to the 1000 bytes that it declares"):
        read_table(path)
    path.write_bytes(content[:where] + (1 << 40).to_bytes(8, "little") + content[where + 8 :])
    with pytest.raises(InputError, match="a chunk unpacks to more than 256 MiB"):
        read_table(path)


def test_values_beyond_the_limit_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_json(tmp_path / "a.mcap", [("/a", {"x": [0] * 4000, "image": [0] * 5000})] * 30)
    table = read_table(path)
    assert table.header.left_out == {"image": "it has 5000 values, 4096 at most"}
    monkeypatch.setattr("connectors.files.trace_table.LIMIT", 1 << 20)
    with pytest.raises(InputError, match="has more than 1 MiB of values"):
        read_table(path)


@pytest.mark.parametrize(
    ("module", "extra", "make"), [("mcap", "mcap", BAGS[".mcap"]), ("rosbags", "ros", BAGS[".db3"])]
)
def test_a_missing_library_is_named_with_its_extra(
    module: str,
    extra: str,
    make: Callable[[Path], Path],
    tmp_path: Path,
    hide_packages: Callable[..., None],
) -> None:
    path = make(tmp_path)
    hide_packages(module)
    with pytest.raises(InputError, match=rf"needs {module}: in the clone, pip install -e '.\[{extra}\]'"):
        read_table(path, topic="/pad")


def test_other_encodings_and_broken_definitions_are_refused(tmp_path: Path) -> None:
    for number, (encoding, form, definition, reason) in enumerate(
        [
            ("protobuf", "protobuf", b"", "has protobuf messages; only json and cdr"),
            ("cdr", "ros2msg", b"uint16[ counts", "has an invalid definition of pad"),
            ("cdr", "", b"", "has messages of type pad/msg/Pad without its definition"),
        ]
    ):
        path = tmp_path / f"{number}.mcap"
        with path.open("wb") as file:
            writer: Any = Writer(file)
            writer.start()
            schema = writer.register_schema("pad/msg/Pad", form, definition)
            writer.add_message(writer.register_channel("/a", encoding, schema), 1, b"\0\1\0\0abc", 1)
            writer.finish()
        with pytest.raises(InputError, match=reason):
            read_table(path)


def test_schemas_of_one_name_may_differ(tmp_path: Path) -> None:
    path, head = tmp_path / "pads.mcap", b"\0\1\0\0"
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        for definition, data in ((b"uint8 a", b"\x05"), (b"uint16 b", b"\x07\0")):
            schema = writer.register_schema("pad/msg/Pad", "ros2msg", definition)
            writer.add_message(writer.register_channel("/pad", "cdr", schema), 1, head + data, 1)
        writer.finish()
    table = read_table(path)
    assert [np.nansum(table.reals(name, lenient=True)) for name in ("a", "b")] == [5, 7]


def test_a_bag_is_replayed_like_any_trace(tmp_path: Path) -> None:
    trace = Trace(read_table(BAGS[".mcap"](tmp_path), topic="/pad"))
    fingertip = trace.fingertip(Touch)
    assert fingertip is not None
    assert fingertip.rate == pytest.approx(100)
