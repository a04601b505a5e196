from pathlib import Path

import pytest

from flows.cli.terminal import check_output_file
from operators.errors import EndpointError


def test_an_output_file_needs_an_existing_folder_and_a_file_name(tmp_path: Path) -> None:
    check_output_file(tmp_path / "new.html")
    missing = f"new.html: folder {tmp_path / 'none'} does not exist: create it"
    with pytest.raises(EndpointError, match=missing):
        check_output_file(tmp_path / "none" / "new.html")
    with pytest.raises(EndpointError, match="is a folder: give a file name"):
        check_output_file(tmp_path)
    assert not (tmp_path / "none").exists()
