"""The scripts of docs/how-to/import.md read the formats that they name."""

import json
import sqlite3
import sys
from collections.abc import Callable
from contextlib import chdir, closing
from functools import partial
from pathlib import Path
from runpy import run_path
from typing import Any
from warnings import catch_warnings

import h5py
import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.io import savemat

from operators.batch import EVERY, Motion, Touch, concat
from storage import Session
from tests.pages import ROOT, block

ROWS = 200
TIME = np.arange(ROWS) / 100  # s
CELLS = 101.3 + 0.01 * (np.arange(ROWS)[:, None] % 50 + np.arange(6))  # (n, 6) kPa
COUNTS = np.arange(ROWS)[:, None] % 50 + np.arange(6)
MOVING = TIME > 1
BEGIN = 1_795_000_000_000_000_000  # ns


def write_arrays(path: Path) -> None:
    arrays: dict[str, Any] = {"time": TIME, "cells": CELLS.round(2), "moving": MOVING}
    if path.suffix == ".npz":
        np.savez(path, **arrays)
    elif path.suffix == ".mat":
        savemat(path, arrays)
    else:
        with h5py.File(path, "w") as file:
            file.update(arrays)


def write_mcap(path: Path) -> None:
    with path.open("wb") as file:
        writer: Any = McapWriter(file)
        writer.start()
        schema = writer.register_schema("pad", "jsonschema", b"{}")
        channels = [writer.register_channel(topic, "json", schema) for topic in ("/pad", "/other")]
        for row, counts in enumerate(COUNTS.tolist()):
            for channel in channels:
                time = BEGIN + row * 10_000_000
                writer.add_message(channel, time, json.dumps({"counts": counts}).encode(), time)
        writer.finish()


def write_messages(writer: Any, store: Any, serialize: Callable[[Any, str], Any], stamp: Any) -> None:
    """Write touch at 100 Hz and the velocity of the arm at 50 Hz, 1 ms before it."""
    pad = writer.add_connection("/pad", "pad_msgs/msg/Counts", typestore=store)
    arm = writer.add_connection("/arm/twist", "geometry_msgs/msg/TwistStamped", typestore=store)
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"]
    for row, counts in enumerate(COUNTS):
        time = BEGIN + row * 10_000_000
        if row % 2 == 0:
            linear = vector(0.02 if MOVING[row] else 0.0, 0.0, 0.0)
            twist = types["geometry_msgs/msg/Twist"](linear, vector(0.0, 0.0, 0.0))
            header = stamp(time - 1_000_000)
            message = types["geometry_msgs/msg/TwistStamped"](header, twist)
            writer.write(arm, time + 5_000_000, serialize(message, arm.msgtype))
        reading = types["pad_msgs/msg/Counts"](stamp(time), counts.astype(np.uint16))
        writer.write(pad, time + 5_000_000, serialize(reading, pad.msgtype))


def write_bag(path: Path, store_name: Stores, writer: Any) -> None:
    store = get_typestore(store_name)
    store.register(get_types_from_msg("std_msgs/Header header\nuint16[6] counts\n", "pad_msgs/msg/Counts"))

    def stamp(time: int) -> object:
        found = store.types["builtin_interfaces/msg/Time"](*divmod(time, 1_000_000_000))
        number = (0,) if store_name is Stores.ROS1_NOETIC else ()
        return store.types["std_msgs/msg/Header"](*number, found, "pad")

    serialize = store.serialize_ros1 if store_name is Stores.ROS1_NOETIC else store.serialize_cdr
    with writer(path) as bag:
        write_messages(bag, store, serialize, stamp)


def write_humble(path: Path) -> None:
    """Write a bag as ROS 2 did until Humble, in SQLite and without the types of its messages."""
    write_bag(path, Stores.ROS2_HUMBLE, partial(Bag2Writer, version=8))
    with closing(sqlite3.connect(path / "humble.db3")) as database:
        database.executescript("DROP TABLE message_definitions; UPDATE schema SET schema_version = 3")


FILES: dict[str, tuple[str, Callable[[Path], None]]] = {
    **dict.fromkeys(("pad.npz", "pad.mat", "pad.h5"), ("arrays.py", write_arrays)),
    "pad.mcap": ("mcap_json.py", write_mcap),
    "pad.bag": ("bag.py", partial(write_bag, store_name=Stores.ROS1_NOETIC, writer=Bag1Writer)),
    "humble": ("bag.py", write_humble),
    "mcap": (
        "bag.py",
        partial(
            write_bag,
            store_name=Stores.ROS2_HUMBLE,
            writer=partial(Bag2Writer, version=9, storage_plugin=StoragePlugin.MCAP),
        ),
    ),
}


@pytest.mark.parametrize("file", FILES)
def test_the_script_of_a_format_imports_it(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name, write = FILES[file]
    write(tmp_path / file)
    (tmp_path / name).write_text(block(ROOT / "docs/how-to/import.md", name))
    monkeypatch.setattr(sys, "argv", [name, file, "pads"])
    with chdir(tmp_path), catch_warnings(action="error"):
        run_path(name, run_name="__main__")
    session = Session.open(tmp_path / "pads")
    fingertip, touch = session.fingertip(Touch), concat(Touch, list(session.read(Touch, 0)))
    assert fingertip is not None
    if name in ("bag.py", "mcap_json.py"):
        assert touch.counts.tolist() == COUNTS.tolist()
        assert touch.time[0] == BEGIN
    else:
        assert fingertip.unit == "kPa"
        assert touch.counts * fingertip.resolution == pytest.approx(CELLS.round(2), abs=1e-6)
        labels = f"labels of the file: {MOVING.sum()} slip, {ROWS - MOVING.sum()} static"
        assert labels in capsys.readouterr().out
    if name == "bag.py":
        motion = concat(Motion, list(session.read(Motion, EVERY)))
        assert len(motion) == ROWS
        assert motion.velocity[:, 0].tolist() == [0.02 if MOVING[i // 2 * 2] else 0.0 for i in range(ROWS)]
