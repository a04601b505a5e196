import sqlite3
from pathlib import Path

from connectors.mqtt.outbox_wal import committed_frames


def test_it_counts_the_frames_up_to_the_last_commit(tmp_path: Path) -> None:
    db = sqlite3.connect(tmp_path / "a.sqlite", isolation_level=None)
    log = tmp_path / "a.sqlite-wal"
    assert committed_frames(log) == 0
    db.execute("PRAGMA journal_mode = WAL")
    db.execute("PRAGMA wal_autocheckpoint = 0")
    db.execute("CREATE TABLE t (x)")
    for _ in range(5):
        db.execute("INSERT INTO t VALUES (zeroblob(9000))")
    [(_, frames, _)] = db.execute("PRAGMA wal_checkpoint(PASSIVE)")
    assert committed_frames(log) == frames
    db.execute("INSERT INTO t VALUES (1)")  # the log begins anew, with old frames behind
    [(_, frames, _)] = db.execute("PRAGMA wal_checkpoint(PASSIVE)")
    assert committed_frames(log) == frames < 5
    db.close()
    assert committed_frames(log) == 0


def test_a_header_that_is_cut_off_or_nonsense_is_no_crash(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_bytes(b"x")
    assert committed_frames(log) == 0
    log.write_bytes(b"\xff" * 100)
    assert committed_frames(log) == 1
