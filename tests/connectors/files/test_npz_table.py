"""Traces in .npz files."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.files.npz_table import read_npz
from operators.errors import InputError

TIME = np.arange(100) / 100


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "trace.npz"


def put(path: Path, **arrays: NDArray[Any]) -> Path:
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type] # allow_pickle is no array
    return path


def header_of(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    """Return the beginning of an array file that declares a shape."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": kind, "fortran_order": False, "shape": shape})
    return file.getvalue()


@pytest.mark.parametrize("dtype", ["<i2", ">i4", "<f4", "<f8", ">f8", "<u2", "f2", "longdouble"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_of_any_type_and_order_are_columns(path: Path, dtype: str, order: Any) -> None:  # noqa: ANN401
    counts = np.arange(600).reshape(100, 2, 3).astype(dtype, order=order)
    trace = Trace(put(path, time=TIME, counts=counts, label=TIME > 0.5, version=np.array(3)))
    assert trace.touch.counts.tolist() == np.arange(600).reshape(100, 6).tolist()
    assert trace.labels.tolist() == (TIME > 0.5).tolist()
    assert trace.rate == pytest.approx(100)


def test_structured_arrays_and_dates_are_columns(path: Path) -> None:
    rows = np.zeros(3, [("stamp", "datetime64[ms]"), ("p", "i2", 4)])
    rows["stamp"] = np.array(["2026-01-01", "2026-01-02", "2026-01-03"], "datetime64[ms]")
    trace = Trace(put(path, rows=rows), ColumnMap.parse("time=rows.stamp,counts=rows.p*"))
    assert trace.touch.cells == 4
    assert np.diff(trace.touch.time).tolist() == [86_400_000_000_000] * 2


def test_arrays_that_are_no_columns_are_named_with_the_reason(path: Path) -> None:
    put(path, t=TIME, counts=np.zeros((6, 100)), z=np.zeros(100, complex), n=np.array(1))
    with pytest.raises(InputError, match="has the columns 't', none recognised as counts") as caught:
        Trace(path)
    assert "counts0 cannot be used: it has 6 rows, most arrays have 100" in str(caught.value)
    with pytest.raises(InputError, match="column z cannot be used: its values are complex128"):
        Trace(path, ColumnMap.parse("counts=z"))


def test_objects_are_never_unpickled(path: Path) -> None:
    np.savez(path, t=TIME, p=np.arange(100))
    content = io.BytesIO()
    np.lib.format.write_array(content, np.array([None, {}], object), allow_pickle=True)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("counts.npy", content.getvalue())
    with pytest.raises(InputError, match="column counts cannot be used: it holds Python objects"):
        Trace(path, ColumnMap.parse("counts=counts"))


def test_a_declared_shape_must_be_that_of_the_data(path: Path) -> None:
    for shape in ((10**15,), (2**40, 2**40), (-1,), (3,)):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("t.npy", header_of(shape) + bytes(16))
        with pytest.raises(InputError, match=r"damaged or not a .npz file"):
            read_npz(path)


@pytest.mark.parametrize("header", ["(((", "'''", "  x\n y", "{[]: 3}"])
def test_a_damaged_header_is_refused(path: Path, header: str) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        size = len(header).to_bytes(2, "little")
        archive.writestr("t.npy", b"\x93NUMPY\x01\x00" + size + header.encode())
    with pytest.raises(InputError, match=r"damaged or not a .npz file"):
        read_npz(path)


def test_a_file_that_unpacks_to_more_than_the_limit_is_refused(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("connectors.files.trace_table.LIMIT", 1 << 20)
    put(path, t=np.zeros(1 << 18))
    assert path.stat().st_size < 1 << 14
    with pytest.raises(InputError, match="unpacks to more than 1 MiB"):
        read_npz(path)


def test_an_entry_that_lies_about_its_size_is_refused(path: Path) -> None:
    put(path, t=np.zeros(1 << 20))
    content = bytearray(path.read_bytes())
    at = content.rindex(b"PK\x01\x02") + 24  # size in the central directory
    content[at : at + 4] = (1000).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"damaged or not a .npz file"):
        read_npz(path)
