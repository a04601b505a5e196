import errno
import os
from pathlib import Path

import pytest

from operators.errors import EndpointError, InputError, ParameterError, SlipflowError
from storage.layout import check_links, new_session_folder, session_folder, session_folders
from tests.storage.made import session_names

OUTSIDE = ["", ".", "..", "../x", "a/b", "/etc", "a\0b"]


@pytest.mark.parametrize("name", [*OUTSIDE, "a\\b", "a\n", ".hidden", "-x", "a b", "ä", "x" * 129])
def test_a_session_is_inside_the_dataset_and_a_new_one_has_a_plain_file_name(name: str) -> None:
    for folder in (new_session_folder, session_folder) if name in OUTSIDE else (new_session_folder,):
        with pytest.raises(ParameterError, match=r"session is .* must be a file name"):
            folder(Path("data"), name)
    assert session_folder(Path("data"), "my copy") == Path("data/sessions/my copy")


@pytest.mark.parametrize("linked", ["sessions/x", "sessions"])
def test_a_session_given_by_its_folder_is_inside_the_dataset_too(tmp_path: Path, linked: str) -> None:
    (tmp_path / "elsewhere/x").mkdir(parents=True)
    (tmp_path / "data/sessions").mkdir(parents=True)
    (tmp_path / "mine").symlink_to(tmp_path / "elsewhere")
    check_links(tmp_path / "mine/x")
    check_links(tmp_path / "mine")  # a link of the user's own
    if linked == "sessions":
        (tmp_path / "data/sessions").rmdir()
        (tmp_path / "data/sessions").symlink_to(tmp_path / "elsewhere")
    else:
        (tmp_path / "data/sessions/x").symlink_to(tmp_path / "elsewhere/x")
    with pytest.raises(InputError, match=r"(x|sessions): is a link; a session must have none: replace it"):
        check_links(tmp_path / "data/sessions/x")


def test_only_folders_with_a_session_json_are_sessions(tmp_path: Path) -> None:
    for name in ("b", "a", "begun"):
        (tmp_path / "sessions" / name).mkdir(parents=True)
    for name in ("b", "a"):
        (tmp_path / "sessions" / name / "session.json").touch()
    (tmp_path / "sessions/loop").symlink_to("loop")
    (tmp_path / "sessions/lost").mkdir()
    (tmp_path / "sessions/lost/MANIFEST.json").touch()
    assert session_names(tmp_path) == ["a", "b"]
    assert [path.name for path in session_folders(tmp_path, lost=True)] == ["a", "b", "lost"]
    (tmp_path / "other").mkdir()
    (tmp_path / "other/sessions").touch()
    with pytest.raises(InputError, match="sessions: is a file, must be the folder of the sessions"):
        session_folders(tmp_path / "other")


@pytest.mark.parametrize(("number", "kind"), [(errno.EACCES, InputError), (errno.EIO, EndpointError)])
def test_sessions_that_cannot_be_looked_for_are_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, kind: type[SlipflowError]
) -> None:
    (tmp_path / "sessions").mkdir()

    def listdir(path: str | Path) -> list[str]:
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr(os, "listdir", listdir)
    monkeypatch.setattr(os, "scandir", listdir)
    with pytest.raises(kind, match=f"sessions: cannot be read: {os.strerror(number)}; "):
        session_folders(tmp_path)
