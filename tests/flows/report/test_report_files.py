import errno
import os
from pathlib import Path

import pytest

from flows.report.report_files import make_output_folder, writing
from operators.errors import EndpointError


def test_a_folder_is_made_with_those_above_it(tmp_path: Path) -> None:
    make_output_folder(tmp_path / "a" / "b")
    make_output_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()


def test_a_folder_below_a_file_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(
        EndpointError, match=r"file/out: cannot be made: .*; a file exists where a folder is needed"
    ):
        make_output_folder(tmp_path / "file" / "out")


def test_what_cannot_be_written_is_told_with_what_to_do(tmp_path: Path) -> None:
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(EndpointError) as raised, writing(tmp_path):
        raise full
    assert raised.value.endpoint == str(tmp_path)
    assert raised.value.reason.startswith("cannot be written: No space left on device; free some space")
