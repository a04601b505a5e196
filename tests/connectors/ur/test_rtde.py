import struct
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import pairwise
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.ur.rtde import (
    FORMATS,
    LARGEST,
    Kind,
    Package,
    Packages,
    Recipe,
    RtdeError,
    Value,
    Version,
    ask_outputs,
    names,
    outputs_asked,
    pack,
    text,
)

NAMES = ("timestamp", "actual_TCP_pose", "actual_TCP_speed")
TYPES = ("DOUBLE", "VECTOR6D", "VECTOR6D")

packages = st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=300)), max_size=20)
cuts = st.lists(st.integers(0, 5000), max_size=30)


def split(data: bytes, cuts: list[int]) -> list[bytes]:
    places = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    return [data[start:stop] for start, stop in pairwise(places)]


def read(pieces: list[bytes]) -> tuple[list[Package], str]:
    """The packages that come out, and why no more do."""
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


@pytest.mark.parametrize("size", [0, 2, LARGEST + 1, 65535])
def test_a_size_that_cannot_be_is_an_error_once_the_packages_before_are_out(size: int) -> None:
    sound = pack(Kind.START, b"\1")
    found, error = read([sound + struct.pack(">HB", size, Kind.DATA)])
    assert found == [Package(Kind.START, b"\1")]
    assert str(size) in error


def test_an_incomplete_package_waits_and_takes_no_more_than_the_largest() -> None:
    reader = Packages()
    whole = pack(Kind.DATA, bytes(LARGEST - 3))
    assert not list(reader.feed(whole[:-1]))
    assert list(reader.feed(whole[-1:])) == [Package(Kind.DATA, bytes(LARGEST - 3))]


def test_requests_are_the_bytes_that_the_guide_has() -> None:
    assert pack(Kind.PROTOCOL, b"\0\2").hex() == "0005560002"
    assert pack(Kind.CONTROLLER).hex() == "000376"
    assert pack(Kind.START).hex() == "000353"
    asked = pack(Kind.OUTPUTS, ask_outputs(125.0, ("timestamp", "actual_q")))
    assert asked == b"\x00\x1dO\x40\x5f\x40\0\0\0\0\0timestamp,actual_q"


def test_what_is_asked_is_understood_with_a_comma_at_the_end_too() -> None:
    assert outputs_asked(ask_outputs(500.0, NAMES)) == (500.0, NAMES)
    assert outputs_asked(ask_outputs(500.0, NAMES) + b",") == (500.0, NAMES)
    assert names(b"") == ()


def test_the_motion_of_an_arm_takes_108_bytes() -> None:
    recipe = Recipe.granted(NAMES, b"\1" + b"DOUBLE,VECTOR6D,VECTOR6D")
    values: list[Value] = [1.5, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), (7.0, 8.0, 9.0, 10.0, 11.0, nan)]
    package = pack(Kind.DATA, recipe.pack(values))
    assert package == struct.pack(">HBB13d", 108, ord("U"), 1, 1.5, *range(1, 12), nan)
    assert len(package) == 108


VALUES: dict[str, Value] = {
    "BOOL": True,
    "UINT8": 255,
    "UINT32": 2**32 - 1,
    "UINT64": 2**64 - 1,
    "INT32": -(2**31),
    "DOUBLE": -0.1,
    "VECTOR3D": (0.1, inf, -0.0),
    "VECTOR6D": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
    "VECTOR6INT32": (-1, 2, -3, 4, -5, 6),
    "VECTOR6UINT32": (1, 2, 3, 4, 5, 2**32 - 1),
}


@given(st.lists(st.sampled_from(sorted(VALUES)), min_size=1, max_size=30), st.integers(1, 255))
def test_values_of_every_type_come_back(types: list[str], number: int) -> None:
    assert set(VALUES) == set(FORMATS)
    recipe = Recipe(number, tuple(map(str, range(len(types)))), tuple(types))
    values = tuple(VALUES[kind] for kind in types)
    payload = recipe.pack(values)
    assert payload[0] == number
    assert len(payload) == recipe.size
    assert recipe.unpack(payload) == values
    assert Recipe.granted(recipe.names, recipe.answer) == recipe


@pytest.mark.parametrize("values", [(1, 2), ("a",), (2**31,), (0.5,), ((1, 2, 3),)])
def test_what_no_field_can_carry_is_an_error(values: tuple[Value, ...]) -> None:
    with pytest.raises(RtdeError, match="register"):
        Recipe(1, ("register",), ("INT32",)).pack(values)


@pytest.mark.parametrize(
    ("answer", "named"),
    [
        (b"\0DOUBLE,NOT_FOUND,VECTOR6D", "actual_TCP_pose NOT_FOUND"),
        (b"\1DOUBLE,VECTOR6D,IN_USE", "actual_TCP_speed IN_USE"),
        (b"\1DOUBLE,VECTOR6D,VECTOR7D", "actual_TCP_speed VECTOR7D"),
        (b"\0DOUBLE,VECTOR6D,VECTOR6D", "timestamp, actual_TCP_pose, actual_TCP_speed"),
        (b"\1DOUBLE,VECTOR6D", "3 fields"),
        (b"\1", "3 fields"),
        (b"", "timestamp"),
    ],
)
def test_a_recipe_that_is_not_granted_names_the_fields_at_fault(answer: bytes, named: str) -> None:
    with pytest.raises(RtdeError, match=named):
        Recipe.granted(NAMES, answer)


@pytest.mark.parametrize("payload", [b"", b"\2" + bytes(104), b"\1" + bytes(103), b"\1" + bytes(105)])
def test_data_of_another_recipe_or_size_is_an_error(payload: bytes) -> None:
    with pytest.raises(RtdeError, match="data of"):
        Recipe(1, NAMES, TYPES).unpack(payload)


def test_versions_travel_as_four_numbers() -> None:
    version = Version(5, 11, 0, 108249)
    assert version.payload.hex() == "000000050000000b000000000001a6d9"
    assert Version.read(version.payload) == version
    assert str(version) == "5.11.0.108249"
    with pytest.raises(RtdeError, match="12 bytes"):
        Version.read(bytes(12))


@pytest.mark.parametrize("parse", [outputs_asked, Version.read, partial(Recipe.granted, NAMES), text])
@given(payload=st.binary(max_size=600))
def test_rubbish_in_a_payload_is_an_error_of_our_own_or_none(
    parse: Callable[[bytes], object], payload: bytes
) -> None:
    with suppress(RtdeError):
        parse(payload)
