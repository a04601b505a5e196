from pathlib import Path

import pytest

from flows.cli.options import check_output_file
from operators.errors import EndpointError


def test_a_file_goes_into_a_folder_that_is_there(tmp_path: Path) -> None:
    check_output_file(tmp_path / "new.html")
    with pytest.raises(EndpointError, match=f"new.html: there is no folder {tmp_path / 'none'}: make it"):
        check_output_file(tmp_path / "none" / "new.html")
    with pytest.raises(EndpointError, match="is a folder: give the name of a file"):
        check_output_file(tmp_path)
    assert not (tmp_path / "none").exists()
