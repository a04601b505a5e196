import tracemalloc
from pathlib import Path

import pytest

from operators.errors import InputError
from storage import files


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
    "text", [b"", b"[1]", b"1", b'{"a": NaN}', b"{", b"\xff", b"[" * 100_000, b'{"a":1}}']
)
def test_a_file_without_a_json_object_is_an_input_error(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "x.json").write_bytes(text)
    with pytest.raises(InputError, match=r"x\.json: is not"):
        files.read_json(tmp_path / "x.json")


@pytest.mark.parametrize("item", [b"{},", b"[],", b'{"a":1},', b"0,", b'"",'])
def test_a_file_of_many_values_is_refused_before_it_fills_the_memory(tmp_path: Path, item: bytes) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(b'{"a":[' + item * 2_100_000 + b"0]}")
    tracemalloc.start()
    with pytest.raises(InputError, match="has more than 2,000,000 values, the limit for such a file"):
        files.read_json(path, files.LIST_LIMIT)
    assert tracemalloc.get_traced_memory()[1] < 2 * path.stat().st_size
    tracemalloc.stop()
    with pytest.raises(InputError, match=r"is larger than 8 MiB|has more than"):
        files.read_json(path)


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
