"""Files: read with typed errors, written completely or not at all; their disk is checked first."""

import errno
import fcntl
import os
from collections.abc import Callable
from contextlib import ExitStack, chdir
from pathlib import Path

import pytest

from operators.errors import EndpointError, InputError
from storage import files
from storage.files import PARTIAL, check_disk, partial_output
from storage.toml_text import parse_toml


def test_an_unreadable_file_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="missing: cannot be read: No such file"):
        files.read(tmp_path / "missing")
    with pytest.raises(InputError, match="is not a regular file"):
        files.read(tmp_path)
    (tmp_path / "big").write_bytes(bytes(11))
    with pytest.raises(InputError, match="larger than"):
        files.read(tmp_path / "big", 10)
    assert files.read(tmp_path / "big", 11) == bytes(11)


@pytest.mark.parametrize(
    "text", [b"", b"[1]", b"1", b'{"a": NaN}', b'{"a": 1e400}', b"{", b"\xff", b"[" * 100_000, b'{"a":1}}']
)
def test_a_file_without_a_json_object_is_an_input_error(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "x.json").write_bytes(text)
    with pytest.raises(InputError, match=r"x\.json: is not"):
        files.read_json(tmp_path / "x.json")


def test_looking_for_the_lock_of_a_folder_does_not_lock_it(tmp_path: Path) -> None:
    with ExitStack() as stack:
        descriptor = os.open(tmp_path, os.O_RDONLY)
        stack.callback(os.close, descriptor)
        fcntl.flock(descriptor, fcntl.LOCK_SH)  # as another process that looks
        assert not files.locked(tmp_path)
    with files.exclusive(tmp_path):
        assert files.locked(tmp_path)


def test_a_flipped_bit_anywhere_in_a_checked_object_is_refused_or_changes_nothing(tmp_path: Path) -> None:
    path, content = tmp_path / "about.json", {"rate_hz": 100.5, "units": {"1": "m"}, "gone": None, "all": [1]}
    files.put_checked(path, content)
    data = path.read_bytes()
    for bit in range(8 * len(data)):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(flipped)
        try:
            assert files.read_checked(path) == content, bit
        except InputError:
            continue


Make = Callable[..., None]
MAKERS = [Path.touch, Path.mkdir]


def write_half(make: Make, path: Path, error: type[BaseException]) -> None:
    with partial_output(path, make) as scratch:
        (scratch / "half" if scratch.is_dir() else scratch).write_text("half")
        raise error


def test_an_output_has_its_name_only_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "new/a.mcap"
    with partial_output(path, Path.touch) as scratch:
        scratch.write_bytes(b"whole")
        assert not path.exists()
    assert path.read_bytes() == b"whole"
    with partial_output(tmp_path / "out") as folder:
        (folder / "meta").mkdir()
        (folder / "meta/info.json").write_text("{}")
        assert not (tmp_path / "out").exists()
    (tmp_path / "empty").mkdir()
    with chdir(tmp_path / "empty"), partial_output(Path()) as folder:
        (folder / "a.b").write_text("")
    assert {each.relative_to(tmp_path).as_posix() for each in tmp_path.rglob("*.*")} == {
        "new/a.mcap",
        "out/meta/info.json",
        "empty/a.b",
    }


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
@pytest.mark.parametrize("make", MAKERS)
def test_a_failed_block_leaves_nothing(tmp_path: Path, make: Make, error: type[BaseException]) -> None:
    with pytest.raises(error):
        write_half(make, tmp_path / "a", error)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("there", ["a", "a" + PARTIAL])
def test_existing_files_are_neither_replaced_nor_removed(tmp_path: Path, make: Make, there: str) -> None:
    (tmp_path / there).write_text("mine")
    with pytest.raises(EndpointError, match=r"exists already|being written"):
        write_half(make, tmp_path / "a", AssertionError)
    assert (tmp_path / there).read_text() == "mine"


def test_space_and_fsync_of_the_disk_are_measured_without_leaving_a_file(tmp_path: Path) -> None:
    space, sync = check_disk(tmp_path / "new" / "recordings")
    assert space.text.endswith(" GB free")
    assert sync.text.startswith("fsync ")
    assert list(tmp_path.iterdir()) == []


def test_a_full_and_slow_disk_is_bad(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "FREE_MIN", 1e18)
    monkeypatch.setattr(files, "SYNC_MAX", 0.0)
    space, sync = check_disk(tmp_path)
    assert (space.state, sync.state) == ("bad", "bad")
    assert space.text.endswith(": free some space, or use another disk")


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: int) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(EndpointError, match="cannot be written: Read-only file system; use a writable"):
        check_disk(tmp_path)


@pytest.mark.parametrize(
    "line",
    [
        "rate = " + "[" * 5_000 + "]" * 5_000,
        "rate = " + "{a=" * 5_000 + "1" + "}" * 5_000,
        "rate = " + "1" * 5_000,
    ],
)
def test_a_line_of_toml_that_cannot_be_parsed_is_an_error(line: str) -> None:
    with pytest.raises(InputError, match=r"^mine\.toml: is not valid TOML: "):
        parse_toml(line, "mine.toml")


def test_other_mistakes_in_toml_have_their_line_and_usual_files_are_read() -> None:
    with pytest.raises(InputError, match=r"^a\.toml: is not valid TOML: .*line 2"):
        parse_toml("a = 1\nb =\n", "a.toml")
    text = 'a = ["[[[[", 1.5, 2.5]\n# ' + "[" * 99 + "\n[b.c]\nd = {e = -9223372036854775808}\n"
    assert parse_toml(text, "a.toml") == {"a": ["[[[[", 1.5, 2.5], "b": {"c": {"d": {"e": -(2**63)}}}}
