from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.ur.rtde import (
    Kind,
    Package,
    Packages,
    RtdeError,
    Version,
    ask_outputs,
    granted_types,
    pack,
    text,
)

NAMES = ("timestamp", "actual_TCP_pose", "actual_TCP_speed")

packages = st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=300)), max_size=20)
cuts = st.lists(st.integers(0, 5000), max_size=30)


def split(data: bytes, cuts: list[int]) -> list[bytes]:
    places = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    return [data[start:stop] for start, stop in pairwise(places)]


def read(pieces: list[bytes]) -> tuple[list[Package], str]:
    """Return the packages that come out, and why no more do."""
    reader, found = Packages(), list[Package]()
    try:
        for piece in pieces:
            for package in reader.feed(piece):
                found.append(package)
    except RtdeError as error:
        return found, str(error)
    return found, ""


@given(packages, cuts)
def test_any_cut_of_the_bytes_gives_the_same_packages(sent: list[tuple[int, bytes]], cuts: list[int]) -> None:
    data = b"".join(pack(kind, payload) for kind, payload in sent)
    assert read(split(data, cuts)) == ([Package(*each) for each in sent], "")


@given(st.binary(max_size=2000), cuts)
def test_any_cut_of_rubbish_gives_the_same_packages_and_the_same_error(data: bytes, cuts: list[int]) -> None:
    assert read(split(data, cuts)) == read([data])


def test_requests_are_the_bytes_that_the_guide_has() -> None:
    assert pack(Kind.PROTOCOL, b"\0\2").hex() == "0005560002"
    assert pack(Kind.CONTROLLER).hex() == "000376"
    assert pack(Kind.START).hex() == "000353"
    asked = pack(Kind.OUTPUTS, ask_outputs(125.0, ("timestamp", "actual_q")))
    assert asked == b"\x00\x1dO\x40\x5f\x40\0\0\0\0\0timestamp,actual_q"


def test_versions_travel_as_four_numbers() -> None:
    version = Version.read(bytes.fromhex("000000050000000b000000000001a6d9"))
    assert str(version) == "5.11.0.108249"
    with pytest.raises(RtdeError, match="12 bytes"):
        Version.read(bytes(12))


@pytest.mark.parametrize("parse", [Version.read, partial(granted_types, NAMES), text])
@given(payload=st.binary(max_size=600))
def test_rubbish_in_a_payload_is_an_error_of_our_own_or_none(
    parse: Callable[[bytes], object], payload: bytes
) -> None:
    with suppress(RtdeError):
        parse(payload)
