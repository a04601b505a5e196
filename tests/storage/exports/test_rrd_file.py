"""A session as a Rerun recording, read back by the library's reader."""

import json
from collections.abc import Callable
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from operators.batch import Faults, Labelled, Motion, Slips, Touch, Zeroed, s
from operators.detectors import Psd
from operators.errors import EndpointError, InputError
from operators.score import Score
from operators.zero import Zero
from storage import load_detector
from storage.exports import rrd_file
from storage.exports.rrd_file import export
from storage.hand_labels import LabelSpan
from tests.storage.made import new_batch, record


def read(path: Path) -> dict[str, dict[str, list[Any]]]:
    """The columns of each entity, those that hold for all times as lists of one."""
    found = dict[str, dict[str, list[Any]]]()
    chunks: Any = import_module("rerun.chunk").RrdReader(path).stream()
    for chunk in chunks:
        columns: Any = chunk.to_record_batch()
        entity = found.setdefault(chunk.entity_path, {})
        for name in columns.schema.names[1:]:
            values: Any = columns.column(name)
            listed = values.cast("int64").to_pylist() if name == "time" else values.to_pylist()
            entity.setdefault(name, []).extend(listed)
    return found


@pytest.mark.rerun
def test_counts_have_their_times_and_gaps_for_a_missing_cell(tmp_path: Path) -> None:
    batches = [new_batch(Touch, 50, start=s + finger, finger=finger, seed=finger) for finger in (0, 2)]
    path = tmp_path / "one.rrd"
    assert export(record(tmp_path, batches), path) == {"/touch/0": 50, "/touch/2": 50}
    found = read(path)
    for batch in batches:
        entity = found[f"/touch/{batch.finger}"]
        assert entity["time"] == batch.time.tolist()
        expected = np.where(batch.valid, batch.counts, np.nan)
        np.testing.assert_array_equal(np.array(entity["Scalars:scalars"]), expected)
        assert entity["SeriesLines:names"] == [[f"barometer {cell}" for cell in range(6)]]


@pytest.mark.rerun
def test_speeds_of_arm_and_contact_are_separate_series(tmp_path: Path) -> None:
    motion, samples = new_batch(Motion, 30, start=s), new_batch(Labelled, 40, start=s, finger=1)
    motion.velocity[:] = np.arange(180).reshape(30, 6)
    path = tmp_path / "one.rrd"
    export(record(tmp_path, [motion, samples]), path)
    found = read(path)
    speed = np.sqrt(np.square(motion.velocity[:, :3]).sum(axis=1))
    np.testing.assert_allclose(np.ravel(found["/motion/speed"]["Scalars:scalars"]), speed)
    np.testing.assert_array_equal(np.ravel(found["/samples/1/speed"]["Scalars:scalars"]), samples.speed)


@pytest.mark.rerun
def test_the_probability_is_the_detectors_output(tmp_path: Path) -> None:
    touch = new_batch(Touch, 300, start=s)
    touch.valid[:] = True
    touch.counts[:] = 700 + np.arange(300)[:, None] % 7
    path, detector = tmp_path / "one.rrd", load_detector("tcn")
    export(record(tmp_path, [touch]), path, detector)
    found, scores = read(path)["/probability/0"], Score(detector).push(Zero().push(touch))
    assert len(scores)
    assert found["time"] == scores.time.tolist()
    np.testing.assert_allclose(np.ravel(found["Scalars:scalars"]), scores.probability, atol=1e-6)
    zeroed = new_batch(Zeroed, 300, start=s)
    zeroed.valid[:] = True
    zeroed.counts[:] = -5
    export(record(tmp_path / "zeroed", [zeroed]), tmp_path / "zeroed.rrd", detector)
    found, scores = read(tmp_path / "zeroed.rrd")["/probability/0"], Score(detector).push(zeroed)
    np.testing.assert_allclose(np.ravel(found["Scalars:scalars"]), scores.probability, atol=1e-6)


@pytest.mark.rerun
def test_slips_and_faults_are_lines_of_text(tmp_path: Path) -> None:
    time = np.array([s, 2 * s, 3 * s])
    states, shares = np.array([1, 0, 1], np.int8), np.array([0.93, 0.1, 0.9])
    slips = Slips(time, states, time, shares, finger=2)
    cells, kinds = np.array([3, 3], np.int8), np.array([1, 1], np.int8)
    faults = Faults(time[:2], cells, kinds, np.array([True, False]), finger=0)
    path = tmp_path / "one.rrd"
    export(record(tmp_path, [slips, faults]), path)
    found = read(path)
    assert found["/slip/2"]["TextLog:text"] == [
        ["slip onset  p 0.93"],
        ["slip end  p 0.10"],
        ["slip onset  p 0.90"],
    ]
    assert found["/slip/2"]["time"] == time.tolist()
    assert [text for [text] in found["/faults"]["TextLog:text"]] == [
        "finger 0 barometer 3 stuck begins",
        "finger 0 barometer 3 stuck ends",
    ]


@pytest.mark.rerun
def test_the_file_has_the_session_description_and_the_labels_given_by_hand(tmp_path: Path) -> None:
    session, path = record(tmp_path, [new_batch(Touch, 5)]), tmp_path / "one.rrd"
    labels = session.write_hand_labels([LabelSpan(0, 1, 0, "slip")], based_on=0)
    export(session, path)
    documents = read(path)
    [[text]] = documents["/session"]["TextDocument:text"]
    assert json.loads(text) == session.about
    [[text]] = documents["/hand_labels"]["TextDocument:text"]
    assert json.loads(text) == json.loads(json.dumps(asdict(labels)))


@pytest.mark.rerun
def test_a_failed_export_leaves_no_file_and_existing_files_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, path = record(tmp_path / "data", [new_batch(Touch, 50)]), tmp_path / "one.rrd"

    def torn(written: str, claimed: Path) -> None:
        content = Path(written).read_bytes()
        Path(written).write_bytes(content[: len(content) // 2])
        check(written, claimed)

    check = rrd_file.check_complete
    with monkeypatch.context() as patched:
        patched.setattr(rrd_file, "check_complete", torn)
        with pytest.raises(EndpointError, match="is incomplete: is the disk full"):
            export(session, path)
    last = max(session.folder.glob("touch/*.parquet"))
    last.write_bytes(last.read_bytes()[:-1])
    with pytest.raises(InputError, match="is damaged"):
        export(session, path)
    assert [each.name for each in tmp_path.iterdir()] == ["data"]
    path.write_text("mine")
    with pytest.raises(EndpointError, match="exists already"):
        export(session, path)
    assert path.read_text() == "mine"


def test_a_missing_library_is_an_error_with_the_fix(
    tmp_path: Path, hide_packages: Callable[..., None]
) -> None:
    hide_packages("rerun-sdk")
    session = record(tmp_path / "data", [new_batch(Touch)])
    with pytest.raises(InputError, match=r"needs rerun-sdk: in the clone, pip install -e '\.\[rerun\]'$"):
        export(session, tmp_path / "one.rrd")
    assert not (tmp_path / "one.rrd").exists()


@pytest.mark.rerun
def test_a_session_shorter_than_the_baseline_has_probabilities(tmp_path: Path) -> None:
    touch = new_batch(Touch, 60, start=s)
    touch.valid[:] = True
    found = export(record(tmp_path, [touch]), tmp_path / "one.rrd", Psd())
    assert found == {"/touch/0": 60, "/probability/0": 36}
