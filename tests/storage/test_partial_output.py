"""Output is written under another name until it is complete."""

from pathlib import Path

import pytest

from operators.errors import EndpointError
from storage.files import PARTIAL, partial_output


def test_a_file_has_its_name_only_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.mcap"
    with partial_output(path, Path.touch) as scratch:
        scratch.write_bytes(b"whole")
        assert not path.exists()
    assert path.read_bytes() == b"whole"
    assert list(path.parent.iterdir()) == [path]


def test_a_folder_has_its_name_only_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "out"
    with partial_output(path) as folder:
        (folder / "meta").mkdir()
        (folder / "meta" / "info.json").write_text("{}")
        assert not path.exists()
    assert (path / "meta" / "info.json").read_text() == "{}"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_failed_block_leaves_nothing(tmp_path: Path, error: type[BaseException]) -> None:
    def half_a_file() -> None:
        with partial_output(tmp_path / "a", Path.touch) as file:
            file.write_bytes(b"half")
            raise error

    def half_a_folder() -> None:
        with partial_output(tmp_path / "b") as folder:
            (folder / "half").touch()
            raise error

    for half in (half_a_file, half_a_folder):
        with pytest.raises(error):
            half()
    assert list(tmp_path.iterdir()) == []


def test_existing_files_are_neither_replaced_nor_removed(tmp_path: Path) -> None:
    for name, is_there in (("a", "a"), ("b", "b" + PARTIAL)):
        (tmp_path / is_there).write_text("mine")
        for make in (Path.touch, Path.mkdir):
            with (
                pytest.raises(EndpointError, match=r"exists already|being written"),
                partial_output(tmp_path / name, make),
            ):
                raise AssertionError
        assert (tmp_path / is_there).read_text() == "mine"
